"""PCNDE: the model that is fitted to 3D simulations and predicts their 1D averages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

import numpy as np
import pandas as pd

from pcnde_bridge._typing import Array, StrPath
from pcnde_bridge._utils.archive import with_prefix
from pcnde_bridge._utils.validation import counted, whole
from pcnde_bridge._utils.workers import started_workers
from pcnde_bridge.config import (
    PUBLISHED_CODE,
    ClosureConfig,
    Config,
    PCNDEConfig,
    config_from,
    nearest_preset,
    resolve_config,
)
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.grid import Grid
from pcnde_bridge.data.published import DT, DZ, PERIOD, SHAPE
from pcnde_bridge.engines import EngineChoice, select_engine
from pcnde_bridge.engines.closure_parameters import ClosureParameters
from pcnde_bridge.engines.protocol import Engine
from pcnde_bridge.engines.types import ModelInputs, Solution
from pcnde_bridge.errors import InputError
from pcnde_bridge.hemodynamics.outlet import Outlet, outlet_from
from pcnde_bridge.model.inputs import Inputs, check_cases
from pcnde_bridge.model.kinds import AnyParameters, kind_of
from pcnde_bridge.model.prediction import Prediction
from pcnde_bridge.model.predictor import Arrays, Facts, Predictor
from pcnde_bridge.model.published_weights import read_published_weights
from pcnde_bridge.training import history as histories
from pcnde_bridge.training.history import Iteration
from pcnde_bridge.training.provenance import provenance, provenance_from
from pcnde_bridge.training.trainer import Trainer
from pcnde_bridge.uncertainty.novelty import Novelty
from pcnde_bridge.uncertainty.sampling import Uncertainty


@dataclass(eq=False, repr=False)
class PCNDE(Predictor):
    """Physics-constrained coupled neural differential equations of one vessel type.

    Create a model by :meth:`fit`, :meth:`load` or :meth:`from_published_weights`.

    Attributes
    ----------
    config : PCNDEConfig or ClosureConfig
        Settings of the fit.
    parameters : Parameters or ClosureParameters
        Trained parameters.
    grid : Grid
        Time points (s), axial positions (cm) and period (s) of the training cases.
    engine : Engine
        Engine that computes the predictions.
    provenance : dict
        Facts needed to reproduce the fit: seed, batches, labels and fingerprint of the
        cases, engine, versions, command, time.
    iterations : tuple of Iteration
        Iterations of the fit, for :attr:`history`.
    uncertainty : Uncertainty or None
        Source of the samples of a prediction; only the preset ``physics`` has it.
    novelty : Novelty or None
        Measure of the distance from the training data.
    outlet : Outlet or None
        Outlet that was given for the fit; None if it was fitted, and for other presets.
    """

    file_format = "pcnde-model", 1, "model"

    config: Config
    parameters: AnyParameters
    grid: Grid
    engine: Engine
    provenance: dict[str, Any] = field(default_factory=dict)
    iterations: tuple[Iteration, ...] = ()
    uncertainty: Uncertainty | None = None
    novelty: Novelty | None = None
    outlet: Outlet | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.config, Config) and isinstance(self.grid, Grid)):
            raise InputError("PCNDE needs a configuration and a Grid: use PCNDE.fit or PCNDE.load.")
        self.engine = select_engine(self.engine)
        kind_of(self.config).check(self.config, self.parameters, self.grid, self.uncertainty)

    @classmethod
    def fit(
        cls,
        cases: Cases,
        config: Config | str = "paper",
        engine: EngineChoice = "auto",
        seed: int = 0,
        checkpoint: StrPath | None = None,
        progress: bool | Callable[[Iteration], None] = True,
        outlet: Outlet | None = None,
        executor: Any = None,
    ) -> PCNDE:
        """Train on averaged 3D simulations, as in section 2.4 of the paper.

        Parameters
        ----------
        cases : Cases
            Training cases.
        config : PCNDEConfig, ClosureConfig or str
            Settings, or the name of a preset: ``paper`` as published; ``fast`` the same
            equations trained in seconds; ``physics`` the most accurate, on any
            grid, with uncertainty.
        engine : {'auto', 'julia', 'jax'} or Engine
            Compute engine; see :func:`pcnde_bridge.engines.select_engine`.
        seed : int
            Random seed for the initial weights and the batch order.  The same seed
            on the same machine and engine gives the same bits.
        checkpoint : path-like, optional
            File that stores the state of training after every epoch and after Ctrl-C.
            If it exists, training resumes from it, with the same result, bit for
            bit, as without the interruption.  The state before is stored beside it
            (``.previous``) in case the file is damaged.
        progress : bool or callable
            Whether to show progress; or a function that is called with every
            :class:`~pcnde_bridge.training.history.Iteration`.
        outlet : Outlet, optional
            Outlet of the cases, such as :class:`~pcnde_bridge.hemodynamics.Windkessel`, with
            one value or one for each case (preset ``physics``).  By default a resistance or a
            Windkessel is fitted.
        executor : int or distributed.Client, optional
            Number of processes, or client of a dask cluster, among whose workers the cases are
            divided (preset ``physics`` and engine ``jax``).  Each holds its part, and returns
            sums over it.

        Returns
        -------
        PCNDE
            The fitted model.

        Raises
        ------
        InputError
            If cases and configuration do not fit together, or the checkpoint
            belongs to another run.
        FileError
            If the checkpoint cannot be read or written.
        EngineUnavailableError
            If the engine cannot be used.
        SolveError
            If an equation diverges.

        Examples
        --------
        >>> from pcnde_bridge import PCNDE, load_cases
        >>> train, test = load_cases("published").split("paper")  # doctest: +SKIP
        >>> model = PCNDE.fit(train)  # doctest: +SKIP
        >>> model.evaluate(test)  # doctest: +SKIP
        """
        check_cases("The cases of a fit", cases)
        seed = whole("seed", seed)
        settings = resolve_config(config)
        engine = select_engine(engine)
        kind = kind_of(settings)
        procedure = kind.procedure(cases, settings, engine)
        if outlet is not None:
            kind.check_outlet(outlet)
            procedure.outlet = outlet
        if executor is not None and not (kind.any_grid and engine.name == "jax"):
            raise InputError(
                "Several processes (executor=, --workers) fit one model only with the preset "
                "'physics' and the engine 'jax'. Leave them out, or choose these two."
            )
        with started_workers(executor) as procedure.workers:
            state = Trainer(procedure, checkpoint).fit(seed, progress)
        used = procedure.cases  # of many cases, some are not used by the preset fast
        facts = provenance(used, engine, seed) | state.facts
        novelty = Novelty.fit(used.inflow, used.area_undeformed, used.grid, procedure.left_out)
        fitted = procedure.config, state.parameters, cases.grid, engine, facts, state.history
        return cls(*fitted, state.uncertainty, novelty, outlet)

    @classmethod
    def from_published_weights(
        cls, folder: StrPath, config: PCNDEConfig = PUBLISHED_CODE, engine: EngineChoice = "auto"
    ) -> PCNDE:
        """Create the model with the authors' published weights of flow and area.

        It works on the grid of the published data, with the published code's
        form of the Fourier area, and solves at rtol 1e-6.  It predicts no
        pressure: the weights behind the paper's pressure are not published.

        Parameters
        ----------
        folder : path-like
            Folder of the ``.jld2`` files, or of their folder ``trained_weights``.
        config : PCNDEConfig
            Settings; by default those of the published code.
        engine : {'auto', 'julia', 'jax'} or Engine
            Compute engine.

        Raises
        ------
        FileError
            If the files are missing or damaged.
        """
        if config is PUBLISHED_CODE:
            config = PUBLISHED_CODE.replace(flow={"rtol": 1e-6, "atol": 1e-9})
        _, n_times, n_points = SHAPE
        grid = Grid(DT * np.arange(float(n_times)), DZ * np.arange(float(n_points)), PERIOD)
        parameters = read_published_weights(folder)
        return cls(config, parameters, grid, select_engine(engine), {"source": "published weights"})

    @property
    def history(self) -> pd.DataFrame:
        """Iterations of the fit: stage, epoch, batch, iteration, loss, seconds, outcome."""
        return histories.to_frame(self.iterations)

    @property
    def has_pressure(self) -> bool:
        """Whether the model predicts the pressure."""
        return self.parameters.has_pressure

    def jax_function(
        self, grid: Grid | None = None
    ) -> tuple[Callable[..., Solution], dict[str, Array]]:
        """Return the equations as a pure JAX function, and the trained parameters.

        The function may be used under ``jit``, ``vmap`` and ``grad``.  It checks nothing and
        needs ``jax_enable_x64``.  The derivative by the area is one-sided where the area is
        constant along z, because the losses of narrowing and widening flow differ.

        Parameters
        ----------
        grid : Grid, optional
            Grid of inputs and results; by default that of the training cases.

        Returns
        -------
        function : callable
            ``function(parameters, inflow, area_undeformed)`` predicts one case: Q_in (time,),
            mL/s, and S_u (z,), cm², give flow, area, pressure and wall shear stress, each
            (time, z), in the units of :class:`~pcnde_bridge.engines.types.Solution`.
        parameters : dict of str to array
            Vectors of :class:`~pcnde_bridge.engines.closure_parameters.ClosureParameters`;
            ``outlet`` may also be the response (2, harmonic) of an outlet,
            :meth:`Outlet.response <pcnde_bridge.hemodynamics.outlet.Outlet.response>`.

        Raises
        ------
        InputError
            If the model is not of the preset ``physics``.

        Examples
        --------
        >>> function, parameters = model.jax_function()  # doctest: +SKIP
        >>> jax.grad(lambda s: function(parameters, q, s).pressure[0, 0])(area)  # doctest: +SKIP
        """
        if not isinstance(self.config, ClosureConfig):
            raise InputError("Only models of the preset 'physics' have a JAX function.")
        settings, used = self.config, grid or self.grid

        def function(parameters: Mapping[str, Any], inflow: Any, area_undeformed: Any) -> Solution:
            from pcnde_bridge.engines.jax.closures.engine import solve_one

            return solve_one(parameters, inflow, area_undeformed, used, settings)

        vectors = dict(self.parameters)
        if self.outlet is not None:
            # The end of the vessel, on which a reflection depends, is not known here.
            unknown = np.full(1, np.nan)
            vectors["outlet"] = self.outlet.response(1, used.time, used.period, unknown)[0]
        return function, vectors

    def _with_outlet(self, inputs: Inputs, outlet: Outlet | None = None) -> Inputs:
        chosen, parameters = self.outlet if outlet is None else outlet, self.parameters
        if chosen is None:
            return inputs
        kind_of(self.config).check_outlet(chosen)
        if outlet is None and not chosen.is_common:
            raise InputError(
                "Each training case has its own outlet: give outlet= (--outlet) for a prediction."
            )
        assert isinstance(parameters, ClosureParameters) and isinstance(self.config, ClosureConfig)
        given = ModelInputs(inputs.inflow, inputs.area_undeformed, inputs.grid)
        return replace(inputs, outlet=parameters.respond(chosen, given, self.config))

    def _solve(self, inputs: Inputs) -> Prediction:
        model = self.engine, self.config, self.parameters
        solution, samples = kind_of(self.config).predict(*model, inputs, self.uncertainty)
        return Prediction(
            **solution._asdict(),
            **vars(inputs.grid),
            area_undeformed=inputs.area_undeformed,
            labels=inputs.labels,
            novelty=inputs.novelty,
            samples=samples,
        )

    def to_archive(self) -> tuple[dict[str, Any], Arrays]:
        """Return the content of the model's file: facts for JSON, and arrays."""
        facts = {"config": self.config.to_dict(), "provenance": dict(self.provenance)}
        facts |= {} if self.outlet is None else {"outlet": self.outlet.to_dict()}
        arrays = {"time": self.grid.time, "z": self.grid.z, "period": np.array(self.grid.period)}
        arrays |= {**histories.to_arrays(self.iterations), **dict(self.parameters)}
        for prefix, part in (("uncertainty_", self.uncertainty), ("novelty_", self.novelty)):
            arrays |= {f"{prefix}{name}": array for name, array in part or ()}
        return facts, arrays

    @classmethod
    def _from_parts(cls, facts: Facts, arrays: Arrays, engine: Engine) -> Self:
        config = config_from(facts["config"])
        kind = kind_of(config)
        spread, known = (with_prefix(name, arrays) for name in ("uncertainty_", "novelty_"))
        return cls(
            config,
            kind.parameters(**{f.name: arrays[f.name] for f in fields(kind.parameters)}),
            Grid(arrays["time"], arrays["z"], float(arrays["period"])),
            engine,
            provenance_from(facts["provenance"]),
            histories.from_arrays(arrays),
            Uncertainty(**spread) if spread else None,
            Novelty.from_arrays(known) if known else None,
            outlet_from(facts["outlet"]) if "outlet" in facts else None,
        )

    def _facts(self) -> list[str]:
        name, changes = nearest_preset(self.config)
        more = f" with {counted(len(changes), 'changed setting')}" if changes else ""
        variables = "flow, area, pressure" if self.has_pressure else "flow, area"
        facts = [f"preset {name}{more}: {variables}"]
        if {"cases", "seed"} <= self.provenance.keys():
            facts.append("{cases} training cases, seed {seed}".format_map(self.provenance))
        return [*facts, *self.grid._facts(), f"engine {self.engine.name}"]
