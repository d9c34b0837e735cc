"""verify_kit: verification of a kit or a panel by its path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tactape_fab.base.errors import SpecError
from tactape_fab.base.given_value import refuse_other
from tactape_fab.base.pool import Workers
from tactape_fab.texture.manifest import MANIFEST_NAME, find_manifest, read_any_manifest
from tactape_fab.texture.panel_manifest import is_panel
from tactape_fab.verify.kit import verify_folder
from tactape_fab.verify.panel import verify_panel_folder
from tactape_fab.verify.trip.round_trip import Contact, Progress
from tactape_fab.verify.verification import Beside, OnCheck, Verification


def verify_kit(
    path: str | Path,
    *,
    quick: bool = False,
    contact: Contact | None = None,
    progress: Progress = lambda *_: None,
    on_check: OnCheck = lambda _: None,
    beside: Beside = tuple,
    workers: Workers = 1,
) -> Verification:
    """Verify a kit, or a panel with every kit on it, by its folder or its manifest.json.

    Parameters
    ----------
    path : str or Path
    quick : bool
        Leave out the checks that need a CAD kernel, another program or an extra: OCCT, FreeCAD, PrusaSlicer, the second tag
        detector; and decode a few contacts only.
    contact : Contact, optional
        Sensor and size of the contacts of the full round trip.
    progress : callable
        Called with the name of the step, the amount done and the total.
    on_check : callable
        Called with every line as soon as it is known.
    beside : callable
        Further checks of the same files, run while other programs read the models. Not called if the manifest is unreadable.
    workers : int or str
        Number of processes for the kits of a panel, or the address of a Dask scheduler.

    Returns
    -------
    Verification
        Every line, also when some failed; an unreadable manifest is a failed line.

    Raises
    ------
    SpecError
        When there is no kit at `path`.
    """
    refuse_other(quick, bool, "quick", "bool", "True or False")
    refuse_other(contact, (Contact, type(None)), "contact", "Contact", "what verify's --contact reads, or leave it out")
    file = find_manifest(path)
    if file.name != MANIFEST_NAME:
        raise SpecError(f"{path} is no kit; give the kit's folder or its {MANIFEST_NAME}")
    if is_panel(_format_of(file)):
        return verify_panel_folder(
            file, quick=quick, contact=contact, progress=progress, on_check=on_check, beside=beside, workers=workers
        )
    return verify_folder(file, quick=quick, contact=contact, progress=progress, on_check=on_check, beside=beside)


def _format_of(file: Path) -> dict[str, Any]:
    """Content of a manifest; empty if it cannot be read, which is reported when it is read as a kit's."""
    try:
        return read_any_manifest(file)
    except SpecError:
        return {}
