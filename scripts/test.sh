#!/usr/bin/env bash
# The tests: the live ones, and beside them those without nodes, which take what the live ones leave
# of the processor while they wait. Each file is in one worker, so that what its tests share is made
# once. ROTCAL_LIVE_WORKERS=1 runs one cell at a time; else it is two for each core. At the end it
# says what could not be tried on this machine, and what to install for it.
#
# usage: scripts/test.sh [--quick] [arguments of pytest]    --quick: without those marked slow
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

NONE_SELECTED=5
ROTCAL_NOT_TRIED=$(mktemp)
export ROTCAL_NOT_TRIED
without_nodes=$(mktemp)
others=
trap 'rm -f "$ROTCAL_NOT_TRIED" "$without_nodes"; [[ -z $others ]] || kill "$others"' EXIT

pytest=("${VENV:-.venv}/bin/python" -m pytest --dist loadfile --no-loadscope-reorder)
cells=${ROTCAL_LIVE_WORKERS:-$((2 * $(nproc)))} # before the next line, which nproc heeds
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
# Each half remembers for itself what failed last.
nice "${pytest[@]}" --live never -n auto -o cache_dir=.pytest_cache/without "$@" \
    >"$without_nodes" 2>&1 &
others=$!
"${pytest[@]}" --live only -n "$cells" -o cache_dir=.pytest_cache/live "$@"
result=$?
wait "$others"
code=$?
others=
cat "$without_nodes"
# Of the two halves one may be empty; the first failure is what the whole says.
if [[ $result == 0 || $result == "$NONE_SELECTED" ]] && [[ $code != "$NONE_SELECTED" ]]; then
    result=$code
fi
if [[ -s $ROTCAL_NOT_TRIED ]]; then
    echo "Not tried here (tests, reason):"
    sort "$ROTCAL_NOT_TRIED" | uniq -c
fi
exit "$result"
