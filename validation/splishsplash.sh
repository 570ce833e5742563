#!/bin/sh
# DFSPH against SPlisHSPlasH: sequences that it made with fixed steps of 1 ms, each simulated from its first frame with
# the wall particles recorded beside it, and compared: OUT/NAME/compare.md and OUT/NAME.svg.
#
# usage: validation/splishsplash.sh DATA [OUT]     (from the root of the repository; some minutes)
#
# DATA has the sequences valid/sim_0206 and valid/sim_0301 (viscosity 0.01) and viscosity/sim_visc_V (V = 0.044, 0.174,
# 0.4), 4 and 2 s long: the folder splishsplash/dataset of the reference data that the slow tests read.
set -eu
data=$(cd "${1:?DATA, the folder of the sequences, is missing}" && pwd)
out=${2:-out/splishsplash}
fluvia="cargo run --release --quiet -p fluvia --"
mkdir -p "$out"
run() {
    sequence=$1 viscosity=$2 steps=$3
    name=$(basename "$sequence")
    start="{ \"particles\": \"$data/${sequence}_00.msgpack.zst\" }"
    echo "{ \"walls\": [$start], \"fluids\": [$start], \"viscosity\": $viscosity }" > "$out/$name.json"
    $fluvia simulate "$out/$name.json" --solver dfsph --solver-dt 0.001 --steps "$steps" --out "$out/$name" --overwrite
    $fluvia compare SPlisHSPlasH="$data/$sequence" Fluvia="$out/$name" --out "$out/$name"
    mv "$out/$name/compare.svg" "$out/$name.svg"
}
run valid/sim_0206 0.01 199
run valid/sim_0301 0.01 199
run viscosity/sim_visc_0.044 0.044 99
run viscosity/sim_visc_0.174 0.174 99
run viscosity/sim_visc_0.4 0.4 99
