"""Quantiles of the chi-squared and Student's t distribution, without loading `scipy.stats`."""

from __future__ import annotations


def chi_squared_quantile(probability: float, degrees_of_freedom: float) -> float:
    """The value below which a chi-squared variable falls with this probability."""
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(0.5 * degrees_of_freedom, probability))


def student_t_quantile(probability: float, degrees_of_freedom: float) -> float:
    """The value below which a variable of Student's t distribution falls with this probability."""
    from scipy.special import stdtrit

    return float(stdtrit(degrees_of_freedom, probability))
