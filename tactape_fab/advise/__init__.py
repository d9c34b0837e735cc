"""Advice on W, Δ and part for a contact and a sensor: legal designs, and the contacts that each can locate."""

from tactape_fab.advise.answer import advise, checked
from tactape_fab.advise.question import read_question

__all__ = ["advise", "checked", "read_question"]
