"""Results of one vessel as another program computed them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from pcnde_bridge._typing import Array
from pcnde_bridge._utils.display import Displayed
from pcnde_bridge.data.variables import FIELDS


@dataclass(frozen=True, repr=False)
class VesselResults(Displayed):
    """Results of one vessel in the units and on the grid of its file.

    Attributes
    ----------
    name : str
        Name of the file, for messages.
    flow, area, pressure : array of shape (time, z)
        Averages over the cross-sections.
    area_undeformed : array of shape (z,)
        Undeformed area S_u.
    time, z : array
        Time points; distances along the vessel from its inlet.
    labels : mapping
        Labels of the case in the file.
    units : mapping of str to str
        Units stated in the file, by ``flow``, ``area``, ``pressure``, ``wall_shear_stress``,
        ``z`` and ``time``; ``shape`` if areas cannot be radii or diameters.
    period : float or None
        Length of the cycle, if the file states it.
    predicted : bool
        Whether a model of this package predicted them: its flow may change along the vessel.
    wall_shear_stress : array of shape (time, z), optional
        Average around the circumference.
    """

    name: str
    flow: Array
    area: Array
    pressure: Array
    area_undeformed: Array
    time: Array
    z: Array
    labels: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    period: float | None = None
    predicted: bool = False
    wall_shear_stress: Array | None = None

    def variables(self) -> dict[str, Array]:
        """Return flow, area, pressure and wall shear stress by name, if there are such."""
        return {name: v for name in FIELDS if (v := getattr(self, name)) is not None}

    def as_case(self) -> dict[str, Array]:
        """Return the arrays as those of a data set of one case, by name."""
        fields = {**self.variables(), "area_undeformed": self.area_undeformed}
        cases = {name: values[None] for name, values in fields.items()}
        return {**cases, "time": self.time, "z": self.z}

    def change(self, function: Callable[[Array], Array], **others: Any) -> VesselResults:
        """Return a copy with one function applied to each variable.

        Parameters
        ----------
        function : callable
            Function of an array of shape (time, z).
        **others
            New values of other attributes.
        """
        fields = {name: function(values) for name, values in self.variables().items()}
        return dataclasses.replace(self, **(fields | others))
