"""Mutated logs, configurations and live calls, by seed: `python -m tests.fuzz --help`.

A case is a fault when it panics, aborts, takes more than two seconds of computing, raises anything but an
error of the package, or gives numbers that are not finite without a word.
"""
