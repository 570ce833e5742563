#!/bin/sh
# Makes the pictures of the README and docs/images anew: the runs, then what is drawn of them.
#
# usage: docs/pictures.sh [OUT]     (from the root of the repository; a quarter of an hour)
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
render dam_break -o $images/dam_break_water.png --surface --frame 48 --yaw -32 --pitch 20 --size 1200x720 --plain
simulate waterfall --steps 500
render waterfall -o $images/waterfall.png --surface --frame 440 --pitch 24 --size 1200x900 --plain
simulate two_bodies --steps 60
render two_bodies -o $images/two_bodies.png --surface --color body --frames 0,12,20,30 --size 400
simulate hundred_thousand --steps 60
render hundred_thousand -o $images/hundred_thousand.png --surface --size 1280x640 --plain

# Divergence-free SPH.
simulate obstacle_course --solver dfsph --steps 100
render obstacle_course -o $images/obstacle_course.png --frame 60 --size 900x900 --plain
simulate three_viscosities --solver dfsph --solver-dt 0.001 --steps 40
render three_viscosities -o $images/three_viscosities.png --surface --color body --frames 0,15,30 --yaw 10 --size 420
