"""Numerical studies of the paper: each a function with a typed result that holds a frame."""

from pcnde_bridge.studies.formulations import FormulationStudy as FormulationStudy
from pcnde_bridge.studies.formulations import compare_formulations as compare_formulations
from pcnde_bridge.studies.landscapes import Landscape as Landscape
from pcnde_bridge.studies.landscapes import LandscapeStudy as LandscapeStudy
from pcnde_bridge.studies.landscapes import explore_landscapes as explore_landscapes
from pcnde_bridge.studies.landscapes import loss_landscape as loss_landscape
