"""The command line: a thin layer over the public functions of the package."""

from .app import application, main

__all__ = ["application", "main"]
