"""Compile the kernels of frames, light and composites into numba's cache: `python -m roomlight_server.precompile`.

For images and packages: a server then starts in seconds. The cache is in `NUMBA_CACHE_DIR`, or beside the code. It
holds for the type of processor that compiled it; another one compiles again at its first start.
"""

import os
import sys
from argparse import ArgumentParser

from roomlight.engine.models.choosing import choose_graphs
from roomlight.engine.session import SessionOptions, warm_up
from roomlight_server.answers import composites, light_forms


def main() -> None:
    """Run the kernels once."""
    warm_up(choose_graphs(SessionOptions()))
    light_forms.warm_up()
    composites.warm_up()
    sys.stdout.write(f"kernels compiled into {os.environ.get('NUMBA_CACHE_DIR', 'the folders of the code')}\n")


if __name__ == "__main__":
    ArgumentParser(prog="python -m roomlight_server.precompile", description=__doc__).parse_args()
    main()
