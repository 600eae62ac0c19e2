"""Folder for downloaded and computed data sets."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder(cache: str | os.PathLike[str] | None) -> Path:
    """Return the given folder, else ``PCNDE_CACHE``, else the user's cache folder."""
    chosen = cache or os.environ.get("PCNDE_CACHE")
    if chosen:
        return Path(chosen).expanduser()
    import pooch

    return Path(pooch.os_cache("pcnde_bridge"))
