#!/bin/sh
# Makes the pictures of the README in docs/images anew: the runs, then what is drawn of them. Those of the page, view_*.png, are
# made by a test (CONTRIBUTING.md).
#
# usage: docs/pictures.sh [OUT]     (from the root of the repository; a few minutes)
# FLUVIA names the program to use in place of the one that cargo builds.
set -eu
out=${1:-out/pictures}
images=docs/images
fluvia=${FLUVIA:-cargo run --release --quiet -p fluvia --}
simulate() {
    scene=$1
    shift
    $fluvia simulate "$scene" --out "$out/$scene" --overwrite "$@"
}
render() {
    scene=$1
    shift
    $fluvia render "$out/$scene" "$@"
}

# The learned network.
simulate dam_break --steps 200
render dam_break -o $images/dam_break.png --sheet 4x2
simulate waterfall --steps 500
render waterfall -o $images/waterfall.png --surface --frame 440 --eye 3.7,3.6,-0.9 --look-at 0,0.7,0 \
    --field-of-view 34 --top 1.6 --size 1000x800 --plain
simulate hundred_thousand --steps 60
render hundred_thousand -o $images/hundred_thousand.png --surface --eye 6,3.8,6.2 --look-at 0.4,0.1,0 \
    --field-of-view 32 --size 1280x640 --plain

# The learned network that takes viscosities, and divergence-free SPH.
simulate three_viscosities --weights viscosity --steps 40
$fluvia simulate three_viscosities --solver dfsph --solver-dt 0.001 --steps 40 --out "$out/three_viscosities_dfsph" --overwrite
$fluvia render "learned network=$out/three_viscosities" "DFSPH=$out/three_viscosities_dfsph" -o $images/three_viscosities.png --surface --color body \
    --body-names 'viscosity 0.01,0.1,0.3' --frames 0,15,30 --yaw 10 --size 420
