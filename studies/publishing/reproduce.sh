#!/bin/sh
# Runs this study again in the folder `again`, and compares its answer and its tables byte by byte.
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
rm -rf again
$run study run study.toml -o again
differ=0
for name in NAMES; do
    here="tables/$name"
    [ "$name" = answer.json ] && here="$name"
    cmp "$here" "again/$name" || differ=$((differ + 1))
done
if [ "$differ" != 0 ]; then
    echo "$differ of COUNT files differ; versions.json has the versions and the machine of the study"
    exit 1
fi
echo "all COUNT files are the same"
