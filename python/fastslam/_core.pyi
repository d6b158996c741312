"""The compiled core. Call it through the typed functions of the package."""

__version__: str

def config_schema() -> str:
    """The JSON Schema of the configuration, with a description of every key."""

def resolve_config(json: str) -> str:
    """Fills in defaults and checks every value; a ValueError's message starts with the dotted key."""
