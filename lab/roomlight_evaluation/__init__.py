"""Score light estimates against ground truth.

Each folder answers one question, with the measurement in `evaluation`, its figures in `scores` and its tables in
`tables`:

- `captures`: How good is the light of a stream, at the ground-truth probes of captures (`roomlight eval captures`)?
  An `Estimator` is a session, a baseline, or a folder of panoramas that any program wrote (`estimators`). Also the main
  light (`main_light`), and light by estimated `depth` and `poses`.
- `objects`: How well does the light shade spheres and cast a shadow (`roomlight eval objects`)?
- `composites`: How near are composites to pictures with the object really there (`roomlight eval composite`)?

`walks` scores the networks on walks of datasets and on single images (`roomlight eval walks`),
`drift` with exposure that drifts;
`benchmark` scores spheres in rooms that a seed gives (`roomlight eval benchmark`).

`baselines` has mean colour and warp-and-fill, `confidence` bootstrap intervals.

The metrics themselves are in `roomlight.metrics`.
"""

from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator, PredictionFolder
from roomlight_evaluation.captures.evaluation import (
    evaluate_capture,
    evaluate_captures,
    evaluate_engine,
)
from roomlight_evaluation.captures.scores import CaptureScores

__all__ = [
    "CaptureScores",
    "EngineEstimator",
    "Estimator",
    "PredictionFolder",
    "evaluate_capture",
    "evaluate_captures",
    "evaluate_engine",
]
