#!/bin/sh
# Figure 6's reference: the distance of Eq. 18 between runs with steps of at most 5 ms and of 1 ms on a complex scene,
# over time, and the control, two runs at 1 ms that differ only in their wall particles; then the figure itself, the network
# and DFSPH at 5 ms against DFSPH at 1 ms.
#
# usage: validation/figure_6.sh [OUT [WEIGHTS]]     (from the root of the repository; some minutes)
#
# WEIGHTS, the published ones say, are set beside ours.
set -eu
out=${1:-out/figure_6}
fluvia="cargo run --release --quiet -p fluvia --"
run() {
    name=$1
    shift
    $fluvia simulate obstacle_course --solver dfsph --steps 250 --out "$out/$name" --overwrite "$@"
}
run 1ms --solver-dt 0.001
run 5ms --solver-dt-max 0.005
run control --solver-dt 0.001 --seed 1
$fluvia compare 1ms="$out/1ms" 5ms="$out/5ms" --control "$out/control" --out "$out"
$fluvia evaluate --weights default ${2:+--weights "published=$2"} --solver dfsph --solver-dt-max 0.005 --data "$out/1ms" --out "$out/evaluate"
