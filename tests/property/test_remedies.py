"""Every remedy that a design rule names is typed back, and the rule holds: counted by rule, over every fab and process."""

from __future__ import annotations

import json
import random
import re
import shlex
from collections import Counter
from collections.abc import Iterator
from functools import cache

from click.testing import CliRunner

from tactape_fab.base.templates import profile_names
from tactape_fab.cli import main
from tests.thorough import THOROUGH, some

FABS = profile_names("fabs")
ASKING = {"part-count", "windows", "opening-expansion"}
"""Rules whose remedy is a question to the fab, or another texture."""
NAMED = (
    "--sector 7 --fab jlcpcb-fpc",
    "--sector 7 --fab jlcpcb-fpc --w 2.056",
    "--sector 7 --anchor mesh",
    "--sector 7 --anchor mesh --fab jlcpcb-fpc",
    "--sector 7 --anchor mesh --w 1.45 --delta 0.25",
    *(f"--sector 7 --w {w}" for w in ("1", "1.1", "1.2", "1.3")),
    *(f"--sector 7 --w {w} --coverlay per-part" for w in ("1", "1.1", "1.2", "1.3")),
    "--sector 7 --w 0.5",
    "--sector 7 --delta 0.7",
    "--sector 7 --rotation 90",
    "--sector 7 --part r01005 --coverlay per-part",
    "--sector 7 --part r01005 --anchor spur --w 1.2",
    "--sector 7 --corner-radius 0",
    "--sector 7 --size 100x12",
    "--sector 7 --size 260x60 --fab jlcpcb-fpc --panel none",
    "--sector 7 --fab jlcpcb-fpc --size 700x50",
    "--sector 7 --size 50x700 --fab jlcpcb-fpc",
    "--sector 7 --size 13x8 --w 1.2",
    "--sector 7 --hole 0.8,40,1 --hole 99.6,49.6,0.3",
    "--sector 7 --hole 50,25,0.05",
    "--sector 7 --hole 50,25,2 --hole 51,25,2 --hole 52,25,2",
    "--sector 7 --hole 3,3.5,1",
    "--sector 7 --hole 3,3.5,1 --tag-id 8",
    "--sector 7 --w 2 --anchor spur --stiffener FR4:0.2 --bend-axis x --bend-radius 1",
    "--sector 7 --part block --process fdm",
    "--sector 7 --part cone --process fdm --base 0.3",
    "--sector 7 --part cone --process cnc --negative",
    "--sector 7 --part dome --process fdm --w 1",
    "--sector 7 --part block --process cnc --rotation 30 --body 0.3x0.2x0.05",
    "--sector 7 --process fdm",
    "--sector 7 --part dome --process fdm --hole 50,25,0.4",
)


def alternatives(message: str) -> Iterator[str]:
    """Options that a message says to type, one text for each way out."""
    remedy = message.rpartition("; ")[2].partition(" (at ")[0].replace("a printed element, ", "")
    for way in re.split(r",? or (?=--|use |leave |another |a s)", remedy):
        if "--" in way and not re.search(r"in (its|their) place|(shorter|another|smaller) --", way):
            yield way  # moved holes: tests/unit/kit/rules/test_spacing.py


def left_out(words: list[str], option: str, value: str | None = None) -> list[str]:
    """The words without an option and its value, or only where it has this one."""
    at = [i for i, word in enumerate(words) if word == option and value in (None, *words[i + 1 : i + 2])]
    ends = [i + 1 if words[i + 1 : i + 2] == [] or words[i + 1].startswith("--") else i + 2 for i in at]
    gone = {i for start, end in zip(at, ends, strict=True) for i in range(start, end)}
    return [word for i, word in enumerate(words) if i not in gone]


def typed(command: str, way: str) -> str:
    """The command with the options of a remedy in place of its own."""
    way, _, gone = way.replace(" and --", ", --").partition(" without ")
    words, said = shlex.split(command), shlex.split(way[way.index("--") :].replace(", --", " --"))
    for option in re.findall(r"--[\w-]+", gone):
        words = left_out(words, option)
    for i, option in enumerate(said):
        if option.startswith("--"):
            value = next((word for word in said[i + 1 : i + 2] if not word.startswith("--")), None)
            words = left_out(words, option, value if "leave out" in way else None)
    return shlex.join(words if "leave out" in way else [*words, *said])


@cache
def findings(command: str) -> tuple[str, dict[str, dict[str, object]]]:
    """What `check` refuses, and its findings by rule, of several the broken one."""
    words = ["check", *shlex.split(command), "--json"]
    result = CliRunner().invoke(main, words, prog_name="tactape-fab", catch_exceptions=False)
    if result.exit_code not in (0, 3):
        return result.stderr, {}
    found: dict[str, dict[str, object]] = {}
    for row in json.loads(result.stdout):
        if row["rule"] not in found or not row["passed"]:
            found[row["rule"]] = row
    return "", found


def blocking(rows: dict[str, dict[str, object]]) -> set[str]:
    return {rule for rule, row in rows.items() if row["level"] == "block" and not row["passed"]}


def try_back(command: str, tried: Counter[str]) -> Iterator[str]:
    """Type back every remedy of a command's broken rules, warnings and notes; what does not work is told."""
    refused, rows = findings(command)
    if refused:
        yield f"{command}: {refused}"
    for rule, row in rows.items():
        message = str(row["message"])
        if row["passed"] or rule in ASKING:
            continue
        ways = list(alternatives(message))
        if not ways and row["level"] != "info" and not re.search(r"ask|another --part|place", message):
            yield f"{command}: {rule} names nothing to type: {message}"
        for way in ways:
            again = typed(command, way)
            refused, now = findings(again)
            if refused or (rule in now and not now[rule]["passed"]):
                yield f"{command}: {rule}: {way}: {again}: {refused or now[rule]['message']}"
            if worse := blocking(now) - blocking(rows):
                yield f"{command}: {rule}: {way}: {again} breaks {worse}"
            tried[rule] += 1


def random_command(rng: random.Random) -> str:
    rotation = rng.choice((0, 30, 40, 90, 135)) if rng.random() < 0.3 else 45
    anchor = rng.choice(("none", "none", "spur", "mesh") if rotation in (45, 135) else ("none", "spur"))
    pitch_mm = rng.choice((0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.7, 2.0, 2.2))
    words = [
        f"--sector {rng.randrange(200)} --fab {rng.choice(FABS)} --size {rng.choice(('100x50', '40x30', '30x24'))} --w {pitch_mm}"
    ]
    words += [f"--delta {rng.uniform(0.08, 0.35) * pitch_mm:.3f}"] * (rng.random() < 0.5)
    words += [f"--anchor {anchor} --rotation {rotation} --panel none"]
    words += ["--part r01005"] * (rng.random() < 0.15)
    words += [rng.choice(("--no-3d", "", "--process sla", "--process fdm"))]
    return " ".join(words)


REFUSED = (
    "--sector 7 --fab jlcpcb-fpc --size 100x50 --coverlay lpi --w 1",
    "--sector 7 --fab generic-fr4 --size 12x10 --w 2.2 --rotation 30 --coverlay per-part",
    "--sector 7 --fab jlcpcb-fpc --size 60x20 --w 1 --rotation 30 --anchor mesh --part r01005",
    "--sector 7 --fab jlcpcb-fpc --size 12x10 --w 2 --rotation 30 --anchor mesh --panel none",
    "--sector 7 --fab pcbway-fr4 --stiffener FR4:0.2",
    "--sector 7 --fab jlcpcb-fr4 --bend-axis x --bend-radius 5 --w 1.05 --delta 0.167 --no-3d",
    "--sector 7 --fab jlcpcb-fr4 --bend-axis x --bend-radius 5 --coverlay lpi",
    "--sector 7 --fab generic-fr4 --anchor mesh --rotation 20 --no-3d",
    "--sector 7 --code touch-1 --directions 8 --fab pcbway-fpc --x2 off --size 30x24 --no-3d",
    "--sector 7 --code touch-1 --directions 8 --w 1.1 --delta 0.266 --size 20x16 --no-3d",
    "--sector 24 --fab pcbway-fpc --size 30x24 --delta 0.3 --tag-cell 5 --part r0402",
    "--sector 7 --size 238x12 --panel 10x10 --tabs x --same-sector --no-3d",
    "--sector 7 --part dome --panel 2x2 --tabs x",
    "--sectors 0 --size 60x20 --panel 2x3 --no-3d",
    "--sectors 0-2 --size 70x30 --panel 2x3 --no-3d",
)


def refused_command(rng: random.Random) -> str:
    """A film whose coverlay the fab may not do, or with a mesh beside parts that are not on a diagonal."""
    words = [f"--sector {rng.randrange(200)} --fab {rng.choice(FABS)} --size {rng.choice(('100x50', '40x30', '12x10', '30x24'))}"]
    words += [f"--w {rng.choice((1.2, 1.5, 2.0, 2.2))} --part {rng.choice(('r0201', 'r0201', 'c0201', 'r01005', 'r0402'))}"]
    mesh = rng.random() < 0.5
    words += ["--rotation 30 --anchor mesh" if mesh else f"--coverlay {rng.choice(('lpi', 'per-part'))}"]
    return " ".join([*words, "--no-3d"])


def told(refused: str) -> dict[str, str]:
    """The lines of a refusal by the option or rule that they begin with."""
    lines = [line.removeprefix("error: ") for line in refused.splitlines() if line.startswith("error: ")]
    return {line.split(" ")[0].rstrip(":"): line for line in lines}


def test_every_remedy_of_a_refused_option_is_taken() -> None:
    """What else is refused or broken after it was said beside it."""
    tried, failed, rng = 0, [], random.Random(25)
    for command in (*REFUSED, *(refused_command(rng) for _ in range(some(24)))):
        before = told(findings(command)[0])
        for key, message in before.items():
            for way in alternatives(message):
                again = typed(command, way)
                refused, rows = findings(again)
                after = told(refused) | {rule: str(rows[rule]["message"]) for rule in blocking(rows)}
                failed += [f"{command}: {way}: {again}: {said}" for now, said in after.items() if now == key or now not in before]
                tried += 1
    print(f"{tried} remedies of refused options typed back")
    assert not failed, "\n".join(failed)
    assert tried >= 2 * some(24)


def test_every_remedy_typed_back_works() -> None:
    tried: Counter[str] = Counter()
    rng = random.Random(24)
    commands = [*NAMED[:: 1 if THOROUGH else 4], *(random_command(rng) for _ in range(some(20)))]
    failed = [line for command in commands for line in try_back(command, tried)]
    print(f"{tried.total()} remedies typed back: " + ", ".join(f"{rule} {n}" for rule, n in sorted(tried.items())))
    assert not failed, "\n".join(failed)
    assert tried.total() >= some(240) and set(tried) >= {"opening-bridge", "coverlay"}
    if not THOROUGH:
        return
    assert set(tried) >= {"pad-pad", "body-body", "courtyard", "opening-bridge", "coverlay", "anchor-opening", "anchor-mesh"}
    assert set(tried) >= {"feature", "gap", "height", "base", "size", "label", "corner-radius", "bend-radius"}
