#!/usr/bin/env bash
# How many frames `fluvia view` gets across, and what connections cost a simulation, all on the first two processors. Takes some
# minutes on an idle machine; needs chromium for the part in the page. Prints what it measures, which validation/README.md lists.
set -euo pipefail
cd "$(dirname "$0")/.."
taskset --cpu-list --pid 0,1 $$ > /dev/null
folder=$(mktemp -d)
program=target/release/fluvia
server=""
finish() { [ -z "$server" ] || kill -INT "$server" 2>/dev/null || true; rm -rf "$folder"; }
trap finish EXIT

cargo build --release --locked -p fluvia
cargo build --release --locked -p fluvia-view --example receive

# 5,600 particles, and 100,000.
"$program" simulate dam_break --solver pbf --steps 100 --out "$folder/6k" --quiet
cat > "$folder/large.json" <<'SCENE'
{"walls": [{"shape": "container", "scale": [6, 3, 2.6]}],
 "fluids": [{"shape": "box", "scale": [2.5, 2, 2.5], "translation": [-1.7, 1.03, 0]}]}
SCENE
"$program" simulate "$folder/large.json" --solver pbf --steps 30 --out "$folder/100k" --quiet

serve() {
    "$program" view "$@" --port 0 > "$folder/address" 2> "$folder/errors" &
    server=$!
    until grep -q http "$folder/address"; do
        kill -0 "$server" || { cat "$folder/errors"; exit 1; }
        sleep 0.1
    done
    address=$(sed 's|http://||; s|/$||' "$folder/address")
}
end() { kill -INT "$server"; wait "$server" || true; server=""; : > "$folder/address"; }
receive() { target/release/examples/receive "$address" 10 "$@"; }
# What the server uses now, and the most that it has used.
memory() { grep -E 'VmRSS|VmHWM' "/proc/$server/status"; }

for frames in 6k 100k; do
    echo "== playback of $frames, a program that decodes"
    serve "$folder/$frames"
    receive
    end
    echo "== playback of $frames, the page without drawing"
    FLUVIA_FRAMES="$folder/$frames" cargo test --release --locked -p fluvia --test cli -- \
        --ignored --exact --nocapture view::page::frames_that_the_page_receives | grep 'a second'
done

# Each from the start of the scene, in turn; what the receivers themselves need comes from the same processors.
for round in 1 2 3; do
    for connections in "1 0" "50 10"; do
        echo "== a simulation (dam_break, dfsph), connections and those of them that never read: $connections"
        serve dam_break --solver dfsph
        echo "memory before"
        memory
        # shellcheck disable=SC2086
        time receive $connections
        echo "memory after"
        memory
        end
    done
done
