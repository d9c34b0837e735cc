"""Which W, Δ and part to make for a contact and a sensor: what the rules leave, and what each design would locate."""

from tactape_fab.advise.answer import Advice, Line, advise, checked
from tactape_fab.advise.question import Question, read_question

__all__ = ["Advice", "Line", "Question", "advise", "checked", "read_question"]
