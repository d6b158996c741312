"""Data frames in and out: pandas, Polars, PyArrow and what else narwhals knows; loaded when asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ._given import shown
from .datasets.csv_table import CsvTable
from .datasets.native import clock_problems
from .datasets.native_odometry import odometry_of
from .datasets.native_settings import checked_settings
from .datasets.native_sightings import sightings_of
from .errors import ConfigError, DataError
from .log import Log
from .measured import measured_by_sensor, measured_columns

if TYPE_CHECKING:
    import narwhals as nw

Backend = Literal["pandas", "polars", "pyarrow"]
BACKENDS: tuple[Backend, ...] = ("pandas", "polars", "pyarrow")
_INSTALL = "data frames need the package narwhals: pip install narwhals"
_MODELS = {"sensor": {"model": "range_bearing"}}


def log_from_frames(
    odometry: object, sightings: object, *, config: Mapping[str, Any] | None = None, name: str = "frames"
) -> Log:
    """See `Log.from_dataframe`."""
    if config is not None and not isinstance(config, Mapping):
        raise ConfigError(f"config: got {shown(config)}, expected a mapping such as log.yaml holds")
    models = {} if "sensors" in (config or {}) else _MODELS
    given = {"format_version": 1, **models, **(config or {})}
    try:
        settings = checked_settings(given, Path("config"), {})
        measures = measured_columns(settings.config.get("sensor", {}).get("model"))
        sensors = measured_by_sensor(settings.config)
        seen = sightings_of(frame_table(sightings, "sightings"), measures=measures, sensors=sensors)
        moved = odometry_of(
            frame_table(odometry, "odometry"), model=settings.motion_model, wheels=settings.wheels
        )
        problems = (*moved.problems, *seen.problems, *clock_problems(moved, seen, Path("frames")))
    except DataError as error:
        # The readers of files speak of the file that holds the settings, and of tables as files.
        text = str(error).replace("log.yaml", "config").replace(".csv", "")
        raise DataError(text) from None
    return Log(
        name=settings.name or name,
        source="frames",
        format="native",
        controls=moved.controls,
        sightings=seen.sightings,
        identity_names=seen.identity_names,
        class_names=seen.class_names,
        sensor_names=seen.sensor_names,
        config={"motion": {"model": moved.model}} | settings.config,
        problems=problems,
        notes=tuple(
            note.replace("log.yaml", "config") for note in (*settings.notes, *moved.notes, *seen.notes)
        ),
    )


def to_frame(columns: Mapping[str, Any], backend: Backend) -> Any:
    """A data frame of the columns. Errors: `ConfigError` for an unknown backend or one not installed."""
    if backend not in BACKENDS:
        raise ConfigError(f"backend: got {shown(backend)}, expected one of {', '.join(BACKENDS)}")
    narwhals = _narwhals()
    try:
        return narwhals.from_dict(dict(columns), backend=backend).to_native()
    except ModuleNotFoundError:
        raise ConfigError(f"backend: {backend} is not installed: pip install {backend}") from None


def frame_table(given: object, what: str) -> CsvTable:
    """A data frame as the table that readers of files take; messages name `what` and rows from 0.

    Named indexes of pandas are columns too. Errors: `DataError` for anything that is no data frame.
    """
    narwhals = _narwhals()
    native: Any = given
    if any(name is not None for name in getattr(getattr(native, "index", None), "names", ())):
        native = native.reset_index()
    try:
        frame = narwhals.from_native(native, eager_only=True)
    except TypeError:
        message = f"{what}: got {shown(given)}, expected a data frame of pandas, Polars or PyArrow"
        hint = " (collect a lazy one first; Log.from_arrays takes arrays)"
        raise DataError(message + hint) from None
    if len(frame) == 0 and what == "odometry":
        raise DataError(f"{what}: the data frame has no rows")
    index_of = {str(name): place for place, name in enumerate(frame.columns)}
    return CsvTable(Path(what), index_of, FrameRows(frame, what), header_line=None)


@dataclass(frozen=True)
class FrameRows:
    """The rows of a data frame, as `CsvTable` asks for them."""

    frame: nw.DataFrame[Any]
    what: str

    @property
    def all_lines(self) -> range:
        """Numbers of the rows, from 0."""
        return range(len(self.frame))

    def parse(self, is_text: Sequence[bool]) -> list[NDArray[Any] | None]:
        """Texts as objects, numbers as such (null is NaN); None for what is to be read from text."""
        columns: list[NDArray[Any] | None] = []
        for place, as_text in enumerate(is_text):
            series = self.frame[:, place]
            if as_text:
                columns.append(np.array(self._texts(series), dtype=np.object_))
            elif series.dtype.is_numeric():
                columns.append(_numbers(series))
            else:
                columns.append(None)
        return columns

    @cached_property
    def columns(self) -> tuple[list[Sequence[str]], range]:
        """All columns as text: dates by ISO 8601 in UTC, nothing for null."""
        return [self._texts(self.frame[:, place]) for place in range(self.frame.shape[1])], self.all_lines

    def _texts(self, series: nw.Series[Any]) -> list[str]:
        narwhals = _narwhals()
        if series.dtype == narwhals.Duration:
            hint = "give seconds, as column.dt.total_seconds() does"
            raise DataError(f"{self.what}: column {series.name} holds durations: {hint}")
        if series.dtype == narwhals.Datetime:
            return _iso_dates(series)
        return [_text(value) for value in series.to_list()]


def _numbers(series: nw.Series[Any]) -> NDArray[np.float64]:
    return np.array(series.cast(_narwhals().Float64).to_numpy(), dtype=np.float64)


def _iso_dates(series: nw.Series[Any]) -> list[str]:
    if getattr(series.dtype, "time_zone", None) is not None:
        series = series.dt.convert_time_zone("UTC").dt.replace_time_zone(None)
    dates = np.asarray(series.to_numpy(), dtype="datetime64[ns]")
    texts: list[str] = np.datetime_as_string(dates).tolist()
    return texts


def _text(value: object) -> str:
    """A cell as text; a whole float, which pandas makes of an integer beside a gap, as the integer."""
    if value is None or value != value:
        return ""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)


def _narwhals() -> Any:
    try:
        import narwhals
    except ModuleNotFoundError:
        raise ConfigError(_INSTALL) from None
    return narwhals
