"""Pages of the site that are not in `docs/`: `hooks.py` adds them, `tests/test_site.py` checks them."""

from __future__ import annotations

PAGES = {
    "project/architecture.md": "ARCHITECTURE.md",
    "project/contributing.md": "CONTRIBUTING.md",
    "project/style.md": "STYLE.md",
    "project/testing.md": "TESTING.md",
    "project/changelog.md": "CHANGELOG.md",
    "figures/scale.md": "benchmarks/reports/scale-2026-11-22.md",
}
"""Pages of the site whose text lies outside `docs/`, and where."""

OTHERS = {"figures/scale-2026-11-22.png": "benchmarks/reports/scale-2026-11-22.png"}

REFERENCE = {
    "run": (
        "Python: to run",
        *(
            "fastslam.automatic",
            "fastslam.runner",
            "fastslam.opinion",
            "fastslam.maps",
            "fastslam.localisation",
            "fastslam.filter",
            "fastslam.robot",
            "fastslam.sensors",
            "fastslam.motions",
            "fastslam.live",
            "fastslam.config",
            "fastslam.settings",
            "fastslam.errors",
        ),
    ),
    "logs": (
        "Python: logs",
        *("fastslam.log", "fastslam.datasets", "fastslam.conversion", "fastslam.detection"),
        *("fastslam.examination", "fastslam.dead_reckoning"),
    ),
    "results": (
        "Python: results and scores",
        *("fastslam.result", "fastslam.resultfiles", "fastslam.outputs", "fastslam.evaluation"),
        *("fastslam.health", "fastslam.noise", "fastslam.plots", "fastslam.report", "fastslam.comparison"),
        "fastslam.mcap",
    ),
    "studies": (
        "Python: simulations and studies",
        *(
            "fastslam.simulation",
            "fastslam.calibration",
            "fastslam.tuning",
            "fastslam.monte_carlo",
            "fastslam.sweep",
        ),
        "fastslam.reproduce",
    ),
    "space": (
        "Python: three dimensions",
        *("fastslam.space.log", "fastslam.space.reading", "fastslam.space.native_write"),
        *("fastslam.space.runner", "fastslam.space.learning", "fastslam.space.config"),
        *("fastslam.space.result", "fastslam.space.evaluation", "fastslam.space.outputs"),
        "fastslam.space.simulation",
    ),
}
"""Pages of the reference: title, then modules."""
