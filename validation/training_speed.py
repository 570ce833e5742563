#!/usr/bin/env python3
"""How many particles a second a training takes, beside torch and Open3D: windows of the same data, the published network and loss.

usage: validation/training_speed.py FLUVIA DATA [--updates 6] [--rounds 3] [--precision f32|bf16]
       FLUVIA the program, DATA a folder of sequences in the published format (out/data/train)
Needs: pip install open3d==0.19.0 torch==2.2.2 "numpy<2" tensorboard msgpack zstandard

In turn on the same cores: some updates of torch with batches of 16 windows, drawn at random, and three times as many of `fluvia train`. A
particle counts once for each of the two steps of its window, as in metrics.jsonl. Reading and decompressing are not in the
time of torch, and not in ours where it waits for nothing.
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import msgpack
import numpy as np
import torch
import zstandard

sys.path.append(str(pathlib.Path(__file__).parent.parent / 'fixtures'))
from make_golden import Network

WINDOWS = 16
SEED = 0


def read(path):
    def array(value):
        return np.frombuffer(value[b'data'], value[b'type'] if isinstance(value[b'type'], str) else value[b'type'].decode()
                             ).reshape(value[b'shape'])

    raw = zstandard.ZstdDecompressor().decompressobj().decompress(path.read_bytes())
    frames = msgpack.unpackb(raw, raw=True)
    as_text = lambda item: {key.decode(): value for key, value in item.items()}
    frames = [as_text(item) for item in frames]
    return [{key: torch.from_numpy(array(item[key]).copy()) for key in ('pos', 'vel', 'box', 'box_normals') if key in item}
            for item in frames]


def update(net, optimizer, windows):
    """One step of the published train_network_torch.py; the particles of the batch."""
    def term(predicted, true):
        splits = net.conv0_fluid.nns.neighbors_row_splits
        importance = torch.exp(-(splits[1:] - splits[:-1]).float() / 40)
        return (importance * torch.sqrt(torch.sqrt(((predicted - true)**2).sum(1) + 1e-9))).mean()

    optimizer.zero_grad()
    total, particles = 0, 0
    for start, one, two, box, normals in windows:
        first, velocity = net.step(start['pos'], start['vel'], box, normals)
        total = total + 0.5 * term(first, one['pos'])
        second, _ = net.step(first, velocity, box, normals)
        total = total + 0.5 * term(second, two['pos'])
        particles += 2 * len(start['pos'])
    (128 * total / len(windows)).backward()
    optimizer.step()
    return particles


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument('fluvia')
    parser.add_argument('data', type=pathlib.Path)
    parser.add_argument('--updates', type=int, default=6)
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--precision', default='f32')
    args = parser.parse_args()
    torch.set_num_threads(2)
    rng = np.random.default_rng(SEED)
    paths = sorted(args.data.glob('*.msgpack.zst'))
    parts = [read(path) for path in rng.choice(paths, min(8, len(paths)), replace=False)]

    def batch():
        chosen = []
        for _ in range(WINDOWS):
            frames = parts[rng.integers(len(parts))]
            k = rng.integers(len(frames) - 2)
            chosen.append((frames[k], frames[k + 1], frames[k + 2], frames[0]['box'], frames[0]['box_normals']))
        return chosen

    net = Network(32, [64, 64])
    optimizer = torch.optim.Adam(net.parameters(), lr=1e-3, eps=1e-6)
    ratios = []
    for number in range(args.rounds):
        theirs = []
        for _ in range(args.updates):
            windows = batch()
            start = time.perf_counter()
            particles = update(net, optimizer, windows)
            theirs.append(particles / (time.perf_counter() - start))
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            (folder / 'config.toml').write_text(
                f'[data]\ntrain = ["{args.data.resolve()}"]\n[network]\nintegration = "paper"\n'
                f'[training]\nprecision = "{args.precision}"\n')
            subprocess.run([args.fluvia, 'train', folder / 'config.toml', '--updates', str(3 * args.updates), '--out',
                            folder / 'run', '--threads', '2', '--quiet'], check=True)
            lines = [json.loads(line) for line in (folder / 'run/metrics.jsonl').read_text().splitlines()]
        ours = [line['particles_per_s'] for line in lines if line['kind'] == 'train']
        a, b = statistics.median(theirs), statistics.median(ours)
        ratios.append(b / a)
        print(f'round {number}: torch and Open3D {a / 1e3:.1f}, fluvia {b / 1e3:.1f} thousand particles a second: {b / a:.2f}')
    print(f'ratio: median {statistics.median(ratios):.2f}, {min(ratios):.2f} to {max(ratios):.2f}')


if __name__ == '__main__':
    main()
