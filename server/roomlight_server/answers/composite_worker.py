"""The process that makes composites: `python -m roomlight_server.answers.composite_worker FD`.

It answers as the process of `decode_worker` does. A request is a pickle, which comes from the server alone. The process
gives way to the server's own threads, and keeps networks and kernels until it is closed.
"""

import os
import pickle
from functools import lru_cache
from typing import Final

import cv2

from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.networks.graphs import LightingGraphs
from roomlight.engine.options import SessionOptions
from roomlight.engine.session import Session
from roomlight.errors import ObjectError, ProbeError, SceneError
from roomlight_server.answers.composites import encode, make
from roomlight_server.work.composite_processes import MAX_MEMORY_BYTES, CompositeJob
from roomlight_server.work.decode_worker import Result, main

_NICE: Final = 10


def composite_result(body: bytes) -> Result:
    """Make the composite of a pickled job."""
    try:
        job = CompositeJob(*pickle.loads(body))
        model = SessionOptions(model=job.options.model, weights=job.options.weights, provider=job.options.provider)
        session = Session.from_snapshot(job.snapshot, job.options, graphs=_graphs(model))
        made = make(session, job.frame, job.scene, job.quality)
        return {"poses": made.poses, "visible": made.visible}, (encode(made.picture, job.form),)
    except (SceneError, ObjectError, ProbeError) as error:
        return {"refused": str(error)}, ()
    except Exception as error:
        if (isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem) or "bad_alloc" in str(error):
            raise MemoryError from error  # of a library in C++
        raise


@lru_cache(2)
def _graphs(options: SessionOptions) -> LightingGraphs | None:
    return choose_graphs(options)


if __name__ == "__main__":
    os.nice(_NICE)
    main({"composite": composite_result}, MAX_MEMORY_BYTES)
