"""Makes the pictures of docs/calibrate.md by the commands of that page. Run: python docs/make_calibrate_figures.py"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from argparse import ArgumentParser
from pathlib import Path

DOCS = Path(__file__).parent
BLOCK = re.compile(r"^```(sh|python|toml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def main() -> None:
    with tempfile.TemporaryDirectory() as scratch:
        for language, text in BLOCK.findall((DOCS / "calibrate.md").read_text(encoding="utf-8")):
            if language == "toml":
                Path(scratch, text.removeprefix("# ").partition(":")[0]).write_text(text, encoding="utf-8")
                continue
            lines = [[sys.executable, "-c", text]] if language == "python" else [shlex.split(line) for line in text.splitlines()]
            for line in lines:
                program = line[0] if language == "python" else str(Path(sysconfig.get_path("scripts"), line[0]))
                subprocess.run([program, *line[1:]], cwd=scratch, check=True)
            if Path(scratch, "pictures").is_dir():
                break
        for name in ("residuals", "coverage"):
            shutil.copy(Path(scratch, "pictures", f"{name}.png"), DOCS / "figures" / f"calibrate-{name}.png")


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
