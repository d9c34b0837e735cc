"""Makes the tables and pictures of fabs.md. Run: python docs/make_fabs.py (a test holds the page to the tables)"""

from __future__ import annotations

import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a dependency installs a package `tests`, too

from tactape_fab import TapeSpec, make_kit
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.examine.tape import examine
from tactape_fab.kit.film.anchors import anchor_modes
from tactape_fab.kit.film.coverlay import coverlay_modes, first_legal
from tactape_fab.kit.profiles import load_fab, load_part
from tests.bench.marks import all_replaced

PAGE = Path(__file__).parent / "fabs.md"
FIGURES = Path(__file__).parent / "figures"
PITCH_MM, DISPLACEMENT_MM = 1.5, 0.25
DISPLACEMENTS_MM = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35)
PX = 340
PICTURES = {
    "fab-per-part": {},
    "fab-gang": {"coverlay": "gang"},
    "fab-spur": {"anchor": "spur"},
    "fab-mesh": {"pitch_mm": 1.8, "displacement_mm": DISPLACEMENT_MM, "anchor": "mesh"},
}


def profile_table() -> str:
    """Every profile at the default pitch: its first way, its limit, from which pitch on it is legal, and what is taken."""
    part = load_part("r0201")
    rows = ["| profile | way, bridge | legal from W | at W 1.5 | spurs from W | mesh from W |", "|---|---|---|---|---|---|"]
    for name in profile_names("fabs"):
        fab = load_fab(name)
        modes = coverlay_modes(fab, part, pitch_mm=PITCH_MM, displacement_mm=DISPLACEMENT_MM, rotation_deg=45.0)
        first = next(mode for mode in modes if mode.name == fab.coverlay_modes[0])
        layout = examine(TapeSpec(sector=7, fab=name, coverlay=first.name, models=False)).layout
        spur, mesh = anchor_modes(fab, layout.outlines, part.pads, layout.tape)
        bridge = fab.limits["opening-bridge"].value_mm
        taken = first_legal(modes, fab)
        # a fab of `gang` alone leaves no film that would hold an anchor
        least = ["none" if m.least_pitch_mm is None else f"{m.least_pitch_mm:.3f} mm" for m in (first, spur, mesh)]
        rows.append(f"| `{name}` | {first.name}, {bridge:.2f} mm | {least[0]} | {taken} | {least[1]} | {least[2]} |")
    return "\n".join([*rows, ""])


def pitch_table() -> str:
    """The least legal pitch of `r0201` at 45 degrees by displacement, for each flex profile's first way."""
    part, names = load_part("r0201"), ("generic-fpc", "jlcpcb-fpc", "generic-lpi")
    rows = ["| Δ | " + " | ".join(f"`{name}`" for name in names) + " |", "|---" * (len(names) + 1) + "|"]
    for displacement_mm in DISPLACEMENTS_MM:
        cells = []
        for name in names:
            fab = load_fab(name)
            modes = coverlay_modes(fab, part, pitch_mm=PITCH_MM, displacement_mm=displacement_mm, rotation_deg=45.0)
            cells.append(f"{next(m for m in modes if m.name == fab.coverlay_modes[0]).least_pitch_mm:.3f} mm")
        rows.append(f"| {displacement_mm:g} mm | " + " | ".join(cells) + " |")
    return "\n".join([*rows, ""])


TABLES = {"profiles": profile_table, "pitches": pitch_table}


def pictures() -> None:
    """The same corner of a tape, each way, from the previews of kits."""
    with tempfile.TemporaryDirectory() as folder:
        for name, values in PICTURES.items():
            spec = TapeSpec(sector=7, size_mm=(30.0, 30.0), tag="none", models=False, **values)  # type: ignore[arg-type]
            kit = make_kit(spec, Path(folder) / name)
            image = cv2.imread(str(kit.path / kit.files["preview-png"]))
            assert image is not None
            corner = image[-PX // 2 - 20 : -20, 20 : 20 + PX // 2]
            larger = cv2.resize(corner, (PX, PX), interpolation=cv2.INTER_CUBIC)
            cv2.imwrite(str(FIGURES / f"{name}.png"), larger, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main() -> None:
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(all_replaced(text, {name: table() for name, table in TABLES.items()}), encoding="utf-8")
    pictures()


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
