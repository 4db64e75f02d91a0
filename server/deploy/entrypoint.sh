#!/bin/sh
# Start RoomLight with the kernels that were compiled with the image. numba uses no cache that it cannot write to, and the
# root is read-only: the cache is copied to /tmp (3 MB).
set -eu
export NUMBA_CACHE_DIR="${TMPDIR:-/tmp}/roomlight-kernels"
if [ ! -d "$NUMBA_CACHE_DIR" ]; then
    cp -R /opt/roomlight/kernels "$NUMBA_CACHE_DIR"
fi
exec roomlight "$@"
