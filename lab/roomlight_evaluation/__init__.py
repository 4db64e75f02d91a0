"""Score light estimates against ground truth.

Two questions, each with an evaluation, its scores and its tables:

- How good is the light of a video stream? `evaluate_captures` scores estimators frame by frame at the ground-truth
  probes of captures (`roomlight eval captures`): `capture_evaluation`, `capture_scores`, `capture_tables`. An
  `Estimator` is a session, a baseline, or a folder of panoramas that any program wrote (`estimators`).
- How good is the light of a single image? `evaluate_dataset` scores methods on the first frames of a dataset's rooms
  (`roomlight eval dataset`): `dataset_evaluation`, `dataset_scores`, `dataset_tables`, `dataset_picture`.

The metrics themselves are in `roomlight.metrics`.
"""

from roomlight_evaluation.captures.estimators import EngineEstimator, Estimator, PredictionFolder
from roomlight_evaluation.captures.evaluation import (
    evaluate_capture,
    evaluate_captures,
    evaluate_engine,
    evaluate_predictions,
)
from roomlight_evaluation.captures.scores import CaptureScores
from roomlight_evaluation.datasets.evaluation import evaluate_dataset
from roomlight_evaluation.datasets.methods import BaselineMethod, EngineMethod, Method
from roomlight_evaluation.datasets.scores import DatasetScores

__all__ = [
    "BaselineMethod",
    "CaptureScores",
    "DatasetScores",
    "EngineEstimator",
    "EngineMethod",
    "Estimator",
    "Method",
    "PredictionFolder",
    "evaluate_capture",
    "evaluate_captures",
    "evaluate_dataset",
    "evaluate_engine",
    "evaluate_predictions",
]
