"""The paper's localization method, section III as written, kept for comparison; every function names its equation.

The text leaves some things open; our reading is given in the docstring of the function concerned.
"""

from __future__ import annotations

from tactape_fab.sense.decode.paper.method import PaperTrace, locate_paper, locate_paper_dots
from tactape_fab.sense.decode.paper.preprocess import estimate_scale
from tactape_fab.sense.decode.paper.windows_read import Reading

__all__ = ["PaperTrace", "Reading", "estimate_scale", "locate_paper", "locate_paper_dots"]
