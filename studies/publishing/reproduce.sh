#!/bin/sh
# Runs this study again in the folder `again`, and compares its answer and its tables byte by byte.
# Exit status: 0 all the same, 1 some differ, 2 it cannot run.
set -eu
cd "$(dirname "$0")"
export NEUROTACT_DATA="$PWD/data"
for run in "${NEUROTACT:-neurotact}" "python -m neurotact" "python3 -m neurotact" ""; do
    [ -z "$run" ] || ! $run --version >/dev/null 2>&1 || break
done
if [ -z "$run" ]; then
    echo "neurotact VERSION is not here; activate the environment that has it, or install it into this one" >&2
    exit 2
fi
for sums in sha256sum "shasum -a 256" ""; do
    [ -z "$sums" ] || ! command -v "${sums%% *}" >/dev/null 2>&1 || break
done
if [ -n "$sums" ] && ! $sums -c HASHES >changed.txt 2>/dev/null; then
    grep -v ': OK$' changed.txt | sort -u >&2 || :
    rm -f changed.txt
    echo "these files are not those of the bundle; unpack it again" >&2
    exit 2
fi
rm -f changed.txt
here=$($run --version)
[ "${here##* }" = "VERSION" ] || echo "this study ran with neurotact VERSION, here is ${here##* }: bytes may differ" >&2
rm -rf again
$run study run study.toml -o again
differ=0
for name in NAMES; do
    here="tables/$name"
    [ "$name" = answer.json ] && here="$name"
    cmp "$here" "again/$name" || differ=$((differ + 1))
done
if [ "$differ" != 0 ]; then
    echo "$differ of COUNT files differ. Versions and the machine of the study (<) and of this run (>), if they differ:"
    diff versions.json again/versions.json || :
    exit 1
fi
echo "all COUNT files are the same"
