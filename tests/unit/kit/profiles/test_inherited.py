"""Fab profiles that extend others: what is inherited, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import process_time

import pytest

from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import profile_names
from tactape_fab.kit.profiles import load_fab
from tactape_fab.kit.profiles.inherited import MOST_ANCESTORS, fab_table
from tactape_fab.texture.board import LEAST_BEND_THICKNESSES


def written(folder: Path, name: str, text: str) -> str:
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return str(folder / f"{name}.toml")


def refusal(profile: str) -> str:
    with pytest.raises(SpecError) as caught:
        load_fab(profile)
    (problem,) = caught.value.problems
    assert problem.message.startswith(problem.key)
    return problem.message


def test_a_profile_takes_what_it_does_not_give_itself(tmp_path: Path) -> None:
    text = 'name = "mine"\nextends = "generic-fpc"\n[limits.pad-pad]\nvalue_mm = 0.09\nconfirmed = true\n'
    mine, generic = load_fab(written(tmp_path, "my-fab", text)), load_fab("generic-fpc")
    pad_pad = replace(generic.limits["pad-pad"], value_mm=0.09, confirmed=True)
    assert mine == replace(generic, name="mine", limits={**generic.limits, "pad-pad": pad_pad})


@pytest.mark.parametrize(("value_mm", "warn_mm"), [(0.149, 0.15), (0.15, None), (0.2, None), (0.3, None)])
def test_a_limit_that_reaches_the_inherited_warning_has_none(tmp_path: Path, value_mm: float, warn_mm: float | None) -> None:
    # generic-fpc warns of less than 0.15 mm, and "leave it out" is no way to leave out what is inherited
    profile = written(tmp_path, "mine", f'extends = "generic-fpc"\n[limits.pad-pad]\nvalue_mm = {value_mm}\n')
    limit = load_fab(profile).limits["pad-pad"]
    assert (limit.value_mm, limit.warn_mm) == (value_mm, warn_mm)
    # nor does it come from further up, past a warning that is reached
    written(tmp_path, "house", 'extends = "generic-fpc"\n[limits.pad-pad]\nwarn_mm = 0.12\n')
    wide = load_fab(written(tmp_path, "wide", 'extends = "house.toml"\n[limits.pad-pad]\nvalue_mm = 0.13\n'))
    assert wide.limits["pad-pad"].warn_mm is None
    own = f'extends = "generic-fpc"\n[limits.pad-pad]\nvalue_mm = {value_mm}\nwarn_mm = {value_mm}\n'
    assert "give more than value_mm" in refusal(written(tmp_path, "own", own))


def test_a_list_replaces_the_inherited_one(tmp_path: Path) -> None:
    profile = written(tmp_path, "lists", 'extends = "generic-fpc"\n[stiffener]\nchoices = ["PI 0.1"]\n')
    assert load_fab(profile).stiffener.choices == ("PI 0.1",)


def test_the_name_is_not_inherited(tmp_path: Path) -> None:
    assert load_fab(written(tmp_path, "my-fab", 'extends = "jlcpcb-fpc"\n')).name == "my-fab"


def test_a_flexible_profile_is_made_rigid_without_its_bend(tmp_path: Path) -> None:
    film = load_fab("generic-fpc").bend
    assert load_fab("generic-fr4").bend is None and film is not None and film.least_thicknesses == LEAST_BEND_THICKNESSES
    assert load_fab(written(tmp_path, "rigid", 'extends = "generic-fpc"\nbend = "none"\n')).bend is None
    with pytest.raises(SpecError, match="fab wrong: bend = 'no' is not a table"):
        load_fab(written(tmp_path, "wrong", 'extends = "generic-fpc"\nbend = "no"\n'))


def test_a_file_extends_a_file_from_its_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "houses").mkdir()
    written(tmp_path, "house", 'extends = "pcbway-fr4"\n[colours]\ncoverlay = "black"\n')
    flexible = written(tmp_path / "houses", "line", 'extends = "../house.toml"\n[material]\nthickness_mm = 1.6\n')
    monkeypatch.chdir(tmp_path / "houses")
    fab = load_fab(flexible)
    assert (fab.name, fab.coverlay_colour, fab.material.thickness_mm) == ("line", "black", 1.6)
    assert fab.size == load_fab("pcbway-fr4").size


@pytest.mark.parametrize("missing", ["extends", "name"])
def test_a_profile_of_its_own_needs_every_key(missing: str, tmp_path: Path) -> None:
    kept = {"extends": 'name = "alone"\n', "name": ""}[missing]
    with pytest.raises(SpecError) as caught:
        load_fab(written(tmp_path, "alone", kept))
    assert "fab alone: limits is missing; give a table of that name" in str(caught.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ('"generic-fcp"', f"is none of: {', '.join(profile_names('fabs'))},"),
        ('"generic-fcp"', "did you mean 'generic-fpc'?"),
        ('"../generic-fpc"', "nor the path of a .toml file"),
        ("3", "extends = 3 is none of: "),
        ('["generic-fpc"]', "; give one of them"),
        ('"elsewhere.toml"', "elsewhere.toml cannot be opened: No such file or directory; give the path of a TOML file"),
        (r'"\u0000.toml"', "cannot be opened: "),
    ],
)
def test_an_unknown_profile_is_refused_with_a_remedy(given: str, said: str, tmp_path: Path) -> None:
    message = refusal(written(tmp_path, "child", f"extends = {given}\n"))
    assert message.startswith("fab child: extends = ") and said in message


@pytest.mark.parametrize("length", [1, 2, 3])
def test_a_cycle_is_refused(length: int, tmp_path: Path) -> None:
    for k in range(length):
        written(tmp_path, f"fab-{k}", f'extends = "fab-{(k + 1) % length}.toml"\n')
    assert refusal(str(tmp_path / "fab-0.toml")).startswith("fab fab-0: extends leads back to fab-0.toml; extend a profile of")


def test_a_link_to_the_profile_itself_is_a_cycle(tmp_path: Path) -> None:
    profile = written(tmp_path, "fab", 'extends = "link.toml"\n')
    (tmp_path / "link.toml").symlink_to(profile)
    assert "leads back to link.toml" in refusal(profile)


def test_chains_are_bounded(tmp_path: Path) -> None:
    last = written(tmp_path, "fab-1", 'extends = "generic-fpc"\n[colours]\ncoverlay = "white"\nlegend = "black"\n')
    for k in range(2, MOST_ANCESTORS + 1):
        last = written(tmp_path, f"fab-{k}", f'extends = "fab-{k - 1}.toml"\n')
    assert load_fab(last).coverlay_colour == "white"
    last = written(tmp_path, "last", f'extends = "fab-{MOST_ANCESTORS}.toml"\n')
    assert f"passes through more than {MOST_ANCESTORS} profiles; extend one that is nearer to the last" in refusal(last)


def test_tables_are_merged_as_deep_as_keys_may_be(tmp_path: Path) -> None:
    deep = f"limits.{'.'.join(['a'] * 63)} = 1\n"
    written(tmp_path, "house", f'extends = "generic-fpc"\n{deep}')
    table = fab_table(written(tmp_path, "line", f'extends = "house.toml"\n{deep}'))
    assert "a" in table.values["limits"] and "pad-pad" in table.values["limits"]


@pytest.mark.parametrize("part", ["a", '"a.b"', "'a'", "a ", '"\\"" ', '"\u2028"'])
@pytest.mark.parametrize(
    "line", ["{} = 1", "[{}]", "[[{}]]", "x = {{ {} = 1 }}", 'x = ["""\n""", {{ {} = 1 }}]', "x = ['''\n''', {{ {} = 1 }}]"]
)
def test_a_key_of_many_parts_is_refused_before_it_is_parsed(part: str, line: str, tmp_path: Path) -> None:
    """100,000 parts took all memory there is."""
    key = ".".join([part] * 50_000)
    path = tmp_path / "deep.toml"
    path.write_text(f"name = 'x'\n{line.format(key)}\n", encoding="utf-8")
    with pytest.raises(SpecError, match="is not TOML: a key has more than 64 parts"):
        fab_table(str(path))


def test_many_dots_that_are_no_key_are_read(tmp_path: Path) -> None:
    path = tmp_path / "dots.toml"
    numbers, words = [0.5] * 100, ".".join("a" * 100)
    path.write_text(f"numbers = {numbers}\nwords = '{words}' # {words}\n", encoding="utf-8-sig")
    assert fab_table(str(path)).values == {"numbers": numbers, "words": words}


def test_a_line_of_dots_and_blanks_is_read_at_once(tmp_path: Path) -> None:
    path = tmp_path / "blanks.toml"
    path.write_text(f"words = '{'.' * 100}'{' ' * 500_000}\n")  # blanks may be before a dot: a second for each 50 kB
    before_s = process_time()
    assert fab_table(str(path)).values == {"words": "." * 100}
    assert process_time() - before_s < 2.0


def test_problems_of_inherited_values_are_those_of_the_profile(tmp_path: Path) -> None:
    written(tmp_path, "house", 'extends = "generic-fpc"\n[limits.pad-pad]\nvalue_mm = -1.0\n[materials]\nbase = "PI"\n')
    with pytest.raises(SpecError) as caught:
        load_fab(written(tmp_path, "line", 'extends = "house.toml"\n[limits.hole-size]\nvalue_mm = "x"\n'))
    keys = {problem.key for problem in caught.value.problems}
    assert keys >= {"materials", "fab line: limits.pad-pad.value_mm", "fab line: limits.hole-size.value_mm"}
