"""What every command writes and answers, as a folder that can be compared with that of another commit.

`python -m tests.golden.record FOLDER` runs the commands below; `diff -r BEFORE AFTER` of two such folders shows what a change of
the code changed for users. Answers are kept digit for digit, without the times they took. It uses the command line alone, so
that it runs on any commit whatever its modules are called.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

_BLOCK = "--part block --w 1.06 --delta 0.2 --size 40x24 --process sla"
_LAMINATES = "--stiffener FR4:0.2 --adhesive 3M468:0.13"
COMMANDS = f"""
make --sector 7 --w 1.5 --delta 0.25
make --sector 9 --size 30x25 --code anoto-6x6 --hole 20,10,1.0 --hole 12,16,0.8 --panel none -o anoto
make --sector 200 --size 40x25 --code debruijn-4x4 --assembly jlcpcb --x2 comments {_LAMINATES} -o debruijn
make --sector 5 --size 44x30 --code touch-1 --w 1.5 -o touch
make --sector 5 {_BLOCK} --directions 8 --code touch-1 -o eight
make --sector 3 --size 40x30 --coverlay lpi --fab generic-lpi --anchor none -o lpi
make --sector 3 --size 40x30 --coverlay gang --fab generic-fr4 -o gang
make --sector 4 --size 40x30 --anchor spur --w 2 --delta 0.3 -o spur
make --sector 4 --size 40x30 --anchor mesh --w 2.4 --delta 0.3 -o mesh
make --sector 4 --size 40x30 --fab pcbway-fr4 --w 2 --no-3d -o pcbway
make --sector 4 --size 40x30 --fab jlcpcb-fr4 --w 2 --no-3d -o jlcfr4
make --sector 4 --size 40x30 --fab pcbway-fpc --w 2.4 --no-3d -o pcbwayfpc
make --sector 11 --size 30x20 --bend-axis x --bend-radius 30 --part r01005 --w 1.2 --delta 0.2 --assembly macrofab -o small
make --sector 12 {_BLOCK} -o block
make --sector 12 {_BLOCK} --cylinder 16 --top single -o cylinder
make --sector 12 --part dome --size 30x20 --negative -o mould
make --sector 12 --part cone --size 30x20 --process fdm --w 3 --delta 0.4 -o cone
make --sector 12 --part dome --size 30x20 --cylinder 25 --shell whole --around y -o whole
make --sector 2 --size 40x20 --avoid tactape-s007 --tag none --no-3d -o avoid
make --sector 2 --size 40x20 --origin best --no-3d -o best
make --panel 2x2 --sectors 7-10 --size 40x30 --no-3d -o panel
make --sectors 7,8,9,10 --panel auto --size 40x30 --fab jlcpcb-fpc --w 2.4 --delta 0.3 --no-3d -o panelauto
make --sectors 20-22 --size 30x20 --no-3d --pack --jobs 2 -o list
make list.toml --no-3d --jobs 2 -o listfile
make --sector 27 --w 1.0
make --sector 7 --w 1.5 --delta nan
make --sector 999 --size 1x1
make --sector 7 --size 10000000x50
make --sector 7 --fab jlcpcb-fpc -o jlc
make --sector 7 --fab nowhere --code none --part missing
check --sector 8
check --sector 27 --fab jlcpcb-fpc --json
check --sector 28 --part dome --process fdm --w 1.0
check --sectors 17,18 --panel 2x2 --same-sector --size 40x30
check --sectors 17-20 --panel 2x2 --size 40x30
check list.toml
verify tactape-s007 --quick --json
verify anoto --json --contact 14x12
verify touch --quick
verify block --json
verify panel --quick --json
verify avoid --map map.png
certify tactape-s007 debruijn --json --picture certify.png
certify touch
registry tactape-s007 debruijn touch list --json
registry tactape-s007 list
simulate tactape-s007 -o frames.npz --count 40 --seed 1
simulate tactape-s007 -o hard.npz --count 60 --seed 2 --contact 6x6 --missing 0.05 --bumps 3 --placement 0.03 --scale-error 0.01
simulate touch -o touch.npz --count 30 --seed 3 --contact 7x7 --sensor digit
simulate eight -o eight.npz --count 30 --seed 3 --contact 7x7
simulate anoto -o anoto.npz --count 20 --seed 4 --contact pad --from-cpl
simulate panel/tapes/tactape-s008 -o panel.npz --count 20 --seed 5 --edge
decode frames.npz --tape tactape-s007 --json
decode frames.npz --tape tactape-s007
decode frames.npz --tape list --tape debruijn --json --world closed
decode hard.npz --tape tactape-s007 --tape debruijn --tape list --json
decode hard.npz --tape tactape-s007 --json --world closed --max-p-tape 1e-2
decode hard.npz --tape debruijn --json
decode frames.npz --code microdots-4x4 --w 1.5 --delta 0.25 --json
decode frames.npz --tape tactape-s007 --method paper --json
decode touch.npz --tape touch --sensor digit --json
decode eight.npz --tape eight --json
decode anoto.npz --tape anoto --json
decode panel.npz --tape panel --json --fixed-scale
decode frames.npz --object object.toml --json --overlay overlays
watch frames.npz --tape tactape-s007 --rate max --no-drop --json
emboss block plate.stl -o emboss --at 0,0,5
emboss block plate.step -o embossstep
advise --contact 6
advise --contact 6 --process sla --json
advise --contact 6 --sensor digit --fab jlcpcb-fpc --explain
profiles
profiles jlcpcb-fpc
profiles generic-fpc --json
"""
LIST = """[[tapes]]
sector = 30
size_mm = [30.0, 20.0]
[[tapes]]
sector = 31
size_mm = [40.0, 20.0]
code = "debruijn-4x4"
"""
OBJECT = """name = "tool"
[[tapes]]
kit = "tactape-s007"
surface = "plane"
position_mm = [10.0, 20.0, 30.0]
rpy_deg = [0.0, 30.0, 45.0]
"""
_TIMES = re.compile(r'"elapsed_ms": [-0-9.e]+|\b[0-9.]+ (ms|s|kits/s|panels/s|Hz)\b|"(seconds|elapsed_s)": [-0-9.e]+')


def record(folder: Path) -> None:
    """Run every command in `folder`, and write what each printed beside what they wrote."""
    folder.mkdir(parents=True)
    (folder / "list.toml").write_text(LIST, encoding="utf-8")
    (folder / "object.toml").write_text(OBJECT, encoding="utf-8")
    _plate(folder)
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "1767225600"}
    program = str(Path(sys.executable).with_name("tactape-fab"))
    said = folder / "said"
    said.mkdir()
    for index, line in enumerate(COMMANDS.strip().splitlines()):
        run = subprocess.run(
            [program, *shlex.split(line)], cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=False
        )
        text = f"$ {line}\nexit {run.returncode}\n--- stdout\n{run.stdout}--- stderr\n{run.stderr}"
        (said / f"{index:02d}-{line.split()[0]}.txt").write_text(_TIMES.sub("TIME", text), encoding="utf-8")
        print(run.returncode, line, flush=True)


def _plate(folder: Path) -> None:
    """A plate of 80 x 60 x 10 mm as the emboss command's surface, as STL and STEP."""
    from build123d import Box, export_step, export_stl

    plate = Box(80, 60, 10)
    export_stl(plate, str(folder / "plate.stl"))
    export_step(plate, str(folder / "plate.step"), timestamp="2026-01-01T00:00:00")


if __name__ == "__main__":
    parser = ArgumentParser(
        prog="python -m tests.golden.record", description=__doc__, formatter_class=RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    record(parser.parse_args().folder)
