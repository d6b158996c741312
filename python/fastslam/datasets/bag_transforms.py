"""Where a frame was over time by the transforms of a bag: a motion capture's or a simulator's truth."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ConfigError
from ..log import Floats, TruthTrajectory
from .bag_messages import frame_of, stamp_of, transform_of
from .bag_topics import TRANSFORMS, messages_on

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader


@dataclass
class _Link:
    """A frame in the one above it, as it was sent: stamps, and matrices (4, 4)."""

    parent: str
    stamp_s: list[float] = field(default_factory=list)
    T_parent_frame: list[Floats] = field(default_factory=list)
    is_static: bool = True

    def at(self, stamp_s: Floats) -> Floats:
        """What was last sent at each stamp; NaN before the first, where it was not always so."""
        order = np.argsort(self.stamp_s, kind="stable")
        matrices = np.stack(self.T_parent_frame)[order]
        if self.is_static:
            return np.broadcast_to(matrices[0], (len(stamp_s), 4, 4))
        row = np.searchsorted(np.array(self.stamp_s)[order], stamp_s, side="right") - 1
        return np.where((row < 0)[:, None, None], np.nan, matrices[np.maximum(row, 0)])


def path_of_frame(
    reader: AnyReader, path: Path, *, frame: str, usual: tuple[str, ...]
) -> tuple[TruthTrajectory, str]:
    """The way of a frame in the topmost one above it, and a note that says which these are.

    Without a frame it is the first of the `usual` ones that moves. There is a pose at each stamp of the
    lowest transform that moves; those above it are taken as last sent. Errors: `ConfigError` for a frame that
    is not there or never moves.
    """
    links = _links(reader)
    moving = [name for name in links if any(not links[one].is_static for one in _chain(links, name))]
    chosen = frame or next((name for name in usual if name in moving), "")
    if chosen not in moving:
        known = ", ".join(sorted(moving)) or "none"
        raise ConfigError(
            f"--topic truth: {path}: no transform moves {chosen or 'the robot'}; name a frame as in "
            f"truth=/tf:FRAME, those that move are: {known}"
        )
    chain = _chain(links, chosen)
    lowest = next(links[name] for name in chain if not links[name].is_static)
    stamp_s = np.unique(lowest.stamp_s)
    whole = np.broadcast_to(np.eye(4), (len(stamp_s), 4, 4))
    for name in chain:
        whole = links[name].at(stamp_s) @ whole
    known_rows = np.isfinite(whole).all(axis=(1, 2))
    stamp_s, whole = stamp_s[known_rows], whole[known_rows]
    heading = np.arctan2(whole[:, 1, 0], whole[:, 0, 0])
    note = f"the truth is {chosen} in {links[chain[-1]].parent}, by transforms"
    return TruthTrajectory(stamp_s, np.column_stack([whole[:, :2, 3], heading])), note


def _links(reader: AnyReader) -> dict[str, _Link]:
    links: dict[str, _Link] = {}
    for name in [name for name, about in reader.topics.items() if about.msgtype in TRANSFORMS]:
        for recorded_s, message in messages_on(reader, name):
            for entry in message.transforms:
                matrix = transform_of(entry.transform.translation, entry.transform.rotation)
                link = links.setdefault(entry.child_frame_id.lstrip("/"), _Link(frame_of(entry)))
                stamp_s = stamp_of(entry)
                link.stamp_s.append(recorded_s if math.isnan(stamp_s) else stamp_s)
                link.T_parent_frame.append(matrix)
                link.is_static = link.is_static and np.allclose(link.T_parent_frame[0], matrix, atol=1e-9)
    return links


def _chain(links: dict[str, _Link], frame: str) -> list[str]:
    """The frame and those above it that are below another one, upwards."""
    found: list[str] = []
    while frame in links and frame not in found:
        found.append(frame)
        frame = links[frame].parent
    return found
