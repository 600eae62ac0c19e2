"""Import of optional packages, with an error that names the extra to install."""

import importlib
from types import ModuleType

from pcnde_bridge.errors import MissingExtraError


def require(module: str, extra: str) -> ModuleType:
    """Import a module of an optional dependency.

    Parameters
    ----------
    module : str
        Full name of the module.
    extra : str
        Extra of this package that installs it.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f"This needs the package {module.partition('.')[0]}, which is not installed: "
            f'pip install ".[{extra}]" in the folder of this package\'s source ({error}).'
        ) from error
