"""Readers that turn a path into a `Log`, the writer of native logs, and a summary of what a log holds."""

from .info import LogInfo, describe
from .native_write import write_native
from .options import LoadOptions
from .registry import FORMATS, DatasetFormat, load

__all__ = ["FORMATS", "DatasetFormat", "LoadOptions", "LogInfo", "describe", "load", "write_native"]
