"""Lets `python -m fastslam` stand for `fastslam`."""

from .cli import main

main()
