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
render waterfall -o $images/waterfall.png --surface --frame 440 --eye 2.5,2.6,1.2 --look-at 0.12,0.58,0 \
    --field-of-view 33 --size 1200x800 --plain
simulate hundred_thousand --steps 60
render hundred_thousand -o $images/hundred_thousand.png --surface --eye 5.4,3.4,5.6 --look-at 0.3,0.3,0 \
    --field-of-view 30 --size 1280x640 --plain

# Divergence-free SPH.
simulate three_viscosities --solver dfsph --solver-dt 0.001 --steps 40
render three_viscosities -o $images/three_viscosities.png --surface --color body \
    --body-names 'viscosity 0.01,0.1,0.3' --frames 0,15,30 --yaw 10 --size 420
