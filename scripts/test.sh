#!/usr/bin/env bash
# The tests, on all cores, each file in one worker, so that what its tests share is made once. The
# live ones wait much, so it is two cells for each core (ROTCAL_LIVE_WORKERS=1: one cell at a time);
# those without nodes take what is left meanwhile, and say first how they ended. At the end it says
# what could not be tried on this machine, and what to install for it.
#
# usage: scripts/test.sh [--quick] [arguments of pytest]    --quick: without those marked slow
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

NONE_SELECTED=5
ROTCAL_NOT_TRIED=$(mktemp)
export ROTCAL_NOT_TRIED
live_log=$(mktemp)
cells=${ROTCAL_LIVE_WORKERS:-$((2 * $(nproc)))} # before the next line, which nproc heeds
export OMP_NUM_THREADS=${OMP_NUM_THREADS:-1}
run=("${VENV:-.venv}/bin/python" -m pytest --dist loadfile --no-loadscope-reorder)

"${run[@]}" --live only -n "$cells" "$@" >"$live_log" 2>&1 &
live=$!
trap 'rm -f "$ROTCAL_NOT_TRIED" "$live_log"' EXIT
trap 'wait "$live"; exit 130' INT # a terminal has told both
trap 'kill -INT "$live"; wait "$live"; exit 143' TERM
nice "${run[@]}" --live never -n auto "$@"
result=$?
echo "The live tests:"
tail --follow --lines +1 --pid "$live" "$live_log"
wait "$live"
live_result=$?
# Of the two halves one may be empty; the first failure is what the whole says.
if [[ $result == 0 || $result == "$NONE_SELECTED" ]] && [[ $live_result != "$NONE_SELECTED" ]]; then
    result=$live_result
fi
if [[ -s $ROTCAL_NOT_TRIED ]]; then
    echo "Not tried here (tests, reason):"
    sort "$ROTCAL_NOT_TRIED" | uniq -c
fi
exit "$result"
