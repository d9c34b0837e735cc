"""Command line: parse, call one function, print. The only modules that know click."""

from tactape_fab.cli.advising import advise
from tactape_fab.cli.answers import FAILED, RULES, USAGE, VERIFICATION
from tactape_fab.cli.completing import complete_values
from tactape_fab.cli.group import main
from tactape_fab.cli.helping import completion, doctor
from tactape_fab.cli.locating import decode, simulate
from tactape_fab.cli.making import check, emboss, make, profiles
from tactape_fab.cli.proving import certify, registry, verify
from tactape_fab.cli.watching import watch

complete_values(main)

__all__ = [
    "FAILED",
    "RULES",
    "USAGE",
    "VERIFICATION",
    "advise",
    "certify",
    "check",
    "completion",
    "decode",
    "doctor",
    "emboss",
    "main",
    "make",
    "profiles",
    "registry",
    "simulate",
    "verify",
    "watch",
]
