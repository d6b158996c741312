"""The experiments of the FastSLAM paper (AAAI 2002), remade one by one, with EKF-SLAM beside it.

Each experiment writes a figure (PNG and SVG), its data as CSV, and says what the paper reports and what was
measured. Experiments are sweeps: stopped at any time, they go on where they were.
"""

from .experiment import Claim, Experiment, Scale
from .registry import EXPERIMENTS, claims_table, reproduce

__all__ = ["EXPERIMENTS", "Claim", "Experiment", "Scale", "claims_table", "reproduce"]
