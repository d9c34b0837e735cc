"""Command line: parse, call one function, print. The only modules that know click."""

from tactape_fab.cli.advise import advise
from tactape_fab.cli.completion_values import complete_values
from tactape_fab.cli.decode import decode, simulate
from tactape_fab.cli.doctor import completion, doctor
from tactape_fab.cli.exits import FAILED, RULES, USAGE, VERIFICATION
from tactape_fab.cli.group import main
from tactape_fab.cli.make import check, emboss, make, profiles
from tactape_fab.cli.verify import certify, registry, verify
from tactape_fab.cli.watch import watch

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
