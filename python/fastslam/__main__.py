"""Lets `python -m fastslam` stand for `fastslam`."""

from ._entry import main

main()
