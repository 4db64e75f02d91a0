#!/bin/sh
# Make docs/images/film.mp4, film.jpg and composite.jpg: docs/scripts/film.sh FOLDER (six minutes on two cores).
# FOLDER keeps the rendered room; stopped, the same command continues. Run it in the virtual environment.
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
mkdir -p "$1/generator"
git -C "$root" archive eddede4~1 core generator | tar x -C "$1/generator"
PYTHONPATH="$1/generator/core:$1/generator/generator" python "$root/docs/scripts/film_room.py" "$1/room"
python "$root/docs/scripts/film.py" "$1/room" "$root/docs/images"
