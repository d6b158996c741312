"""How many particles does a log need? Run it with several numbers of them, and several seeds each."""

import fastslam
from fastslam.evaluation import evaluate, summarize
from fastslam.simulation import resolve_simulation, simulate

log = simulate(resolve_simulation({"seed": 1}, preset="demo"))
print("particles   path error (mean ± 95 % of 5 seeds)   time per run")
for particles in (1, 10, 100):
    results = fastslam.run_many(log, {"filter": {"particles": particles}}, seeds=range(5))
    summary = summarize([evaluate(result, log) for result in results])
    error, seconds = summary["ate_rmse_m"], summary["filter_seconds"]
    print(f"{particles:9d}   {error.mean:.3f} ± {error.ci95:.3f} m {seconds.mean:35.3f} s")
