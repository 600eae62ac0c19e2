"""Data sets by name or path, and the download of the published one."""

import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

from pcnde_bridge._typing import StrPath
from pcnde_bridge._utils.files import cache_folder, check_file, expanded, is_folder
from pcnde_bridge._utils.validation import listed
from pcnde_bridge.data.cases import Cases
from pcnde_bridge.data.files import SUFFIXES
from pcnde_bridge.data.published import read_authors_folder
from pcnde_bridge.errors import DataNotFoundError, FileError

#: The authors' public repository and the commit that the checksums belong to.
PUBLISHED_REPOSITORY = "https://github.com/amir-cardiolab/PCNDE"
PUBLISHED_COMMIT = "6ec3ff924ff531207a54d4e54529760f36769616"
PUBLISHED_URL = f"https://raw.githubusercontent.com/amir-cardiolab/PCNDE/{PUBLISHED_COMMIT}/"

_FOLDER = f"csala2024-{PUBLISHED_COMMIT[:7]}"
_FORMATS = {".csv": "csv", ".vtp": "simvascular", ".pvd": "simvascular", ".in": "sv1d"}
_STALLED = 20.0  # s without a byte after which a download is repeated


def find_published() -> Path | None:
    """Look for the published data set on this machine.

    The places are, in this order: the folder named by the environment variable
    ``PCNDE_DATA``; ``../shared/csala2024`` relative to the working directory and to the
    root of the repository, a copy that several checkouts share; a complete download in
    the cache.

    Returns
    -------
    pathlib.Path or None
        The folder that contains ``data_3D``, or None if there is none.

    Raises
    ------
    DataNotFoundError
        If ``PCNDE_DATA`` is set but does not name such a folder.
    """
    named = os.environ.get("PCNDE_DATA")
    if named:
        folder = expanded(named)
        if not is_folder(folder / "data_3D"):
            why = "contains no folder data_3D" if is_folder(folder) else "does not exist"
            raise DataNotFoundError(
                f"PCNDE_DATA is {named!r}, which {why}; give the folder of data_3D"
            )
        return folder.resolve()
    for start in (Path.cwd(), Path(__file__).resolve().parents[2]):
        folder = start.parent / "shared" / "csala2024"
        if (folder / "data_3D").is_dir():
            return folder
    cached = cache_folder(None) / _FOLDER
    # A file gets its name only after its checksum is confirmed, so that it need only exist.
    return cached if all((cached / name).is_file() for name in _checksums()) else None


def download_published(
    cache: StrPath | None = None,
    progress: bool = True,
    *,
    base_url: str = PUBLISHED_URL,
    retries: int = 3,
) -> Path:
    """Download the published data set and trained weights (about 49 MB, 105 files).

    Every file is compared with its known checksum.  Files in the cache are not
    downloaded again, so that an interrupted download can be resumed.

    Parameters
    ----------
    cache : str or path-like, optional
        Folder for the files.  By default the folder named by the environment variable
        ``PCNDE_CACHE``, or else the user's cache folder.
    progress : bool, default True
        Show a progress bar on standard error.
    base_url : str, optional
        Address of the files, for a mirror of the authors' repository.
    retries : int, default 3
        Number of further attempts for each file.

    Returns
    -------
    pathlib.Path
        The folder that contains ``data_3D`` and ``trained_weights``.

    Raises
    ------
    DataNotFoundError
        If a file cannot be downloaded or is not the published one.
    FileError
        If the cache cannot be written.
    """
    import pooch
    import requests
    from rich.console import Console
    from rich.progress import track

    folder, checksums = cache_folder(cache) / _FOLDER, _checksums()
    base = base_url.rstrip("/") + "/"
    # Only the data set has another place in the authors' repository than in the cache.
    urls = {name: base + "data/" * name.startswith("data_3D/") + name for name in checksums}
    fetcher = pooch.create(folder, base, registry=checksums, urls=urls, retry_if_failed=retries)
    downloader = pooch.HTTPDownloader(timeout=_STALLED)
    logger = pooch.get_logger()
    level = logger.level
    logger.setLevel("ERROR")  # by default it prints one line for each file
    names = track(checksums, "Downloading", console=Console(stderr=True), disable=not progress)
    try:
        for name in names:
            fetcher.fetch(name, downloader=downloader)
    except (requests.exceptions.RequestException, ValueError) as error:
        is_network = isinstance(error, requests.exceptions.RequestException)
        why = error if is_network else "it is not the published file: its checksum differs"
        raise DataNotFoundError(
            f"{name} could not be downloaded from {urls[name]}: {why}. Finished files stay in "
            f"{str(folder)!r}; call again to continue. To get the data by hand, download "
            f"{PUBLISHED_REPOSITORY} (commit {PUBLISHED_COMMIT[:7]}) on a machine with a "
            "connection and set PCNDE_DATA to its folder 'data', which contains data_3D"
        ) from error
    except OSError as error:
        if not error.errno:  # requests found no certificates
            advice = "correct REQUESTS_CA_BUNDLE or CURL_CA_BUNDLE, or unset it"
            raise DataNotFoundError(f"{error}; {advice}") from error
        advice = "free space, or set PCNDE_CACHE to another folder"
        raise FileError(f"cannot write to the cache: {error}; {advice}") from error
    finally:
        logger.setLevel(level)
    return folder


def load_cases(data: StrPath | Cases) -> Cases:
    """Load a data set by name or path.

    Parameters
    ----------
    data : str, path-like or Cases
        Name of a data set: ``"published"`` is the one of the paper, found on this machine
        or downloaded; ``"synthetic"`` is computed once by
        :func:`pcnde_bridge.hemodynamics.synthetic.synthetic`.  Or a folder in the layout
        of the published data set, a file written by :meth:`Cases.save`, or a data set,
        which is returned as it is.  A name takes precedence over a path: write
        ``"./published"`` for a folder of this name.

    Returns
    -------
    Cases
        The data set.

    Raises
    ------
    DataNotFoundError
        If there is neither such a name nor such a path, or the published data set can be
        neither found nor downloaded.
    FileError
        If the files are not usable.
    """
    if isinstance(data, Cases):
        return data
    if data == "published":
        return read_authors_folder(find_published() or download_published())
    if data == "synthetic":
        from pcnde_bridge.hemodynamics.synthetic import synthetic

        return synthetic()
    if is_folder(data):
        return read_authors_folder(data)
    try:
        check_file(Path(data), "a data set")
    except DataNotFoundError as error:
        what = f"neither a file or folder nor a data set's name: {listed([*map(repr, DATASETS)])}"
        raise DataNotFoundError(f"{str(data)!r} is {what}") from error
    if Path(data).suffix.lower() not in SUFFIXES:
        rule = f"the name {str(data)!r} must end in one of {', '.join(SUFFIXES)}"
        known = (name for ending, name in _FORMATS.items() if ending in Path(data).suffixes)
        program = next(known, "FORMAT (see pcnde convert --help)")
        raise FileError(f"{rule}; run pcnde convert {data} --out cases.h5 --from {program} first")
    return Cases.load(data)


DATASETS = "published", "synthetic"
"""Data sets that :func:`load_cases` knows by name."""


def _checksums() -> Mapping[str, str]:
    """Return the SHA-256 checksum of each published file, by its name in the cache."""
    text = resources.files("pcnde_bridge.io").joinpath("published_registry.txt").read_text("utf-8")
    return dict(line.split() for line in text.splitlines() if not line.startswith("#"))
