"""Compile the kernels of frames, light and composites into numba's cache: `python -m roomlight_server.precompile`.

For images and packages: a server then starts in seconds. The cache is in `NUMBA_CACHE_DIR`, or beside the code. It
holds for the type of processor that compiled it; another one compiles again at its first start.
"""

import os
import sys
from argparse import ArgumentParser
from collections.abc import Sequence

from roomlight.compositing.rendering import renderer
from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions, warm_up, warm_up_surfaces
from roomlight_server.answers import composites, light_forms


def main(qualities: Sequence[str] = ()) -> None:
    """Run the kernels once: all of them, or meshes' and composites', of these qualities first, at low priority."""
    if qualities:
        if sys.platform != "win32":
            os.nice(10)
        warm_up_surfaces()
    for quality in qualities:
        renderer.warm_up(quality)
    if not qualities:
        warm_up(choose_graphs(SessionOptions()))
        light_forms.warm_up()
    composites.warm_up()
    sys.stdout.write(f"kernels compiled into {os.environ.get('NUMBA_CACHE_DIR', 'the folders of the code')}\n")


if __name__ == "__main__":
    parser = ArgumentParser(prog="python -m roomlight_server.precompile", description=__doc__)
    parser.add_argument("quality", nargs="*", help="preview, good or final: only meshes and composites, these first")
    main(parser.parse_args().quality)
