"""The data files of templates/ are found, and a kit can be made, from a checkout, an editable install and a wheel."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import tactape_fab
from tactape_fab.base.errors import SpecError
from tactape_fab.base.templates import profile_names, read_toml, templates_folder
from tests.thorough import only_thorough, slow

ROOT = Path(tactape_fab.__file__).resolve().parent.parent
FOLDERS = ("tactape_fab", "templates", "tests", "docs")
SOURCES = (*FOLDERS, "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
PROBE = """
import json
import tactape_fab
from tactape_fab.cli import main
from tactape_fab.kit.profiles import load_fab, load_process, profile_names, read_part, templates_folder
names = {kind: profile_names(kind) for kind in ("fabs", "parts", "processes")}
for load, kind in ((load_fab, "fabs"), (read_part, "parts"), (load_process, "processes")):
    [load(name) for name in names[kind]]
main(["make", "--sector", "7", "--size", "20x20", "-o", "kit", "--overwrite"], standalone_mode=False)
print(json.dumps({"package": tactape_fab.__file__, "templates": str(templates_folder()), "names": names}))
"""


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what a checkout holds, so that builds leave this one alone."""
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("the package under test does not come from a checkout, so there is nothing to build; run this in a checkout")
    folder = tmp_path_factory.mktemp("checkout") / "tactape-fab"
    folder.mkdir()
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    return folder


def pip(*args: str | Path) -> None:
    """Run pip without a network, with the build backend that is installed."""
    quiet = ("--disable-pip-version-check", "--no-input", "--quiet")
    done = subprocess.run(
        [sys.executable, "-m", "pip", *quiet, *map(str, args)], capture_output=True, encoding="utf-8", check=False
    )
    assert done.returncode == 0, done.stderr


def probe(command: list[str], cwd: Path, **env: str) -> tuple[Path, Path]:
    """Make a kit in a fresh interpreter; return where its package and its templates came from."""
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run([*command, PROBE], cwd=cwd, env={**clean, **env}, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["names"] == {kind: profile_names(kind) for kind in ("fabs", "parts", "processes")}
    assert (cwd / "kit" / "manifest.json").is_file()
    return Path(found["package"]).resolve().parent, Path(found["templates"]).resolve()


def probe_installed(target: Path, cwd: Path) -> tuple[Path, Path]:
    """The same with `target` as the first site folder, ahead of the one that this test runs in."""
    folders = [str(target), *(p for p in sys.path if p.endswith(("site-packages", "dist-packages")))]
    program = f"import site, sys; [site.addsitedir(folder) for folder in {folders!r}]; exec(sys.argv[1])"
    return probe([sys.executable, "-I", "-S", "-c", program], cwd)


def test_every_template_can_be_read_here() -> None:
    assert templates_folder().is_dir()
    for kind, name in (("fabs", "generic-fpc"), ("parts", "r0201"), ("processes", "sla"), ("sensors", "generic")):
        assert name in profile_names(kind)


def test_checkout_as_current_folder_finds_its_templates(checkout: Path) -> None:
    package, templates = probe([sys.executable, "-c"], checkout)
    assert (package, templates) == (checkout / "tactape_fab", checkout / "templates")
    shutil.rmtree(checkout / "kit")


def test_checkout_on_the_path_finds_its_templates(checkout: Path, tmp_path: Path) -> None:
    package, templates = probe([sys.executable, "-c"], tmp_path, PYTHONPATH=str(checkout))
    assert (package, templates) == (checkout / "tactape_fab", checkout / "templates")


@only_thorough
def test_editable_install_finds_the_templates_of_its_checkout(checkout: Path, tmp_path: Path) -> None:
    pip("install", "--editable", checkout, "--target", tmp_path / "site", "--no-deps", "--no-build-isolation", "--no-index")
    package, templates = probe_installed(tmp_path / "site", tmp_path)
    assert (package, templates) == (checkout / "tactape_fab", checkout / "templates")


def built(sources: Path, folder: Path) -> Path:
    """The wheel of a folder of sources."""
    pip("wheel", sources, "--wheel-dir", folder, "--no-deps", "--no-build-isolation", "--no-index")
    (wheel,) = folder.glob("*.whl")
    return wheel


def files_below(folder: Path) -> set[str]:
    return {p.relative_to(folder.parent).as_posix() for p in folder.rglob("*") if p.is_file() and p.parent.name != "__pycache__"}


@slow
def test_wheel_holds_the_package_and_its_templates_and_nothing_else(checkout: Path, tmp_path: Path) -> None:
    wheel = built(checkout, tmp_path / "dist")
    package, templates = files_below(checkout / "tactape_fab"), files_below(checkout / "templates")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    described = {name.split("/", 1)[1] for name in names if name.split("/")[0].endswith(".dist-info")}
    assert described == {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}
    assert {n for n in names if ".dist-info/" not in n} == package | {f"tactape_fab/{path}" for path in templates}
    assert "tactape_fab/py.typed" in names and "templates/order/base.j2" in templates
    pip("install", wheel, "--target", tmp_path / "site", "--no-deps", "--no-index")
    places = probe_installed(tmp_path / "site", tmp_path)
    assert places == (tmp_path / "site" / "tactape_fab", tmp_path / "site" / "tactape_fab" / "templates")


@only_thorough
def test_sdist_holds_the_tests_and_what_they_read_and_gives_the_same_wheel(checkout: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)]
    done = subprocess.run(command, cwd=checkout, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert {path for name in FOLDERS for path in files_below(unpacked / name)} == {
        path for name in FOLDERS for path in files_below(checkout / name)
    }
    assert {p.name for p in unpacked.iterdir()} == {*SOURCES, "PKG-INFO"}
    assert built(unpacked, tmp_path / "a").read_bytes() == built(checkout, tmp_path / "b").read_bytes()


@only_thorough
def test_wheel_and_sdist_are_the_same_when_built_twice(checkout: Path, tmp_path: Path) -> None:
    built_files = []
    for number, seed in enumerate(("1", "2")):
        sources = tmp_path / f"sources{number}"
        shutil.copytree(checkout, sources)
        for path in sources.rglob("*"):
            if number:  # another umask, and another clock
                path.chmod(0o775 if path.is_dir() else 0o660)
                os.utime(path, (978_307_200, 978_307_200))
        command = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path / f"dist{number}")]
        environment = {**os.environ, "PYTHONHASHSEED": seed, "TZ": f"UTC{number}"}
        done = subprocess.run(command, cwd=sources, env=environment, capture_output=True, encoding="utf-8", check=False)
        assert done.returncode == 0, done.stderr
        built_files.append({path.name: path.read_bytes() for path in (tmp_path / f"dist{number}").iterdir()})
    assert len(built_files[0]) == 2 and built_files[0] == built_files[1]


@pytest.mark.parametrize("number", ["0x" + "f" * 3572, "0o" + "7" * 4763, "0b" + "1" * 14286, "0x" + "_".join("f" * 3572)])
def test_an_integer_that_python_does_not_write_is_refused(number: str, tmp_path: Path) -> None:
    """Python reads it, and raises a ValueError where it is put into a message or a key."""
    with pytest.raises(ValueError, match="4300 digits"):
        str(int(number, 0))
    path = tmp_path / "a.toml"
    path.write_text(f"sector = {number}\n", encoding="ascii")
    with pytest.raises(SpecError, match=r"a\.toml is not TOML: it holds an integer of thousands of digits; correct it"):
        read_toml(path, "spec")
    path.write_text(f"sector = 0x{'f' * 2000}\n", encoding="ascii")
    assert read_toml(path, "spec") == {"sector": int("f" * 2000, 16)}
