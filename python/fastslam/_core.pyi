"""The compiled core. Call it through the typed functions of the package."""

from typing import Any

__version__: str

def config_schema() -> str:
    """The JSON Schema of the configuration, with a description of every key."""

def resolve_config(json: str) -> str:
    """Fills in defaults and checks every value; a ValueError's message starts with the dotted key."""

def simulation_schema() -> str:
    """The JSON Schema of the settings of a simulation."""

def resolve_simulation(json: str) -> str:
    """As `resolve_config`, for the settings of a simulation."""

def simulation_presets() -> list[tuple[str, str]]:
    """Name and settings (JSON) of each ready-made simulation."""

def simulation_with_landmarks(json: str, landmarks: int) -> str:
    """The same simulation with about this many landmarks, at the same density."""

def simulate(json: str) -> dict[str, Any]:
    """Simulates a log; returns its columns by name. ValueError for settings that contradict each other."""
