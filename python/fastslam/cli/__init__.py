"""The command line: a thin layer over the public functions of the package."""

from .app import app, main

__all__ = ["app", "main"]
