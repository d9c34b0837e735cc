"""The package's public names are there, and cost nothing until one is used."""

from __future__ import annotations

import subprocess
import sys

from tactape_fab import verify

HEAVY = ("numpy", "shapely", "cv2", "gerbonara", "numba", "tactape_fab.verify.kit")


def test_naming_the_package_loads_nothing_heavy() -> None:
    code = f"import sys, tactape_fab.verify as v; assert v.__all__; print(*[m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, encoding="utf-8")
    assert done.stdout.split() == []


def test_every_public_name_is_found() -> None:
    assert set(verify.__all__) <= set(dir(verify))
    assert all(callable(getattr(verify, name)) for name in verify.__all__)
