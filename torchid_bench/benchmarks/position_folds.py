"""How near servos fitted to some motions come on the others: folds of whole motions, each with its
own search from the start.

    python -m torchid_bench.benchmarks.position_folds ROBOT LOG... [--folds 5]

Prints RMS errors in mrad of the log's unit, mean of the joints: of all rows together, and the mean
over motions; whole motions from the measured start, and windows of 2 s.
"""

import time

import torch

from torchid.log.model import Log
from torchid.position.answered import best_answer
from torchid.position.model import ServoArm
from torchid.position.problem import pose
from torchid.position.replay import replay
from torchid_bench.benchmarks.position_errors import fold_parser, read_folds


def main() -> None:
    parser = fold_parser(__doc__)
    parser.add_argument("--only", type=int, nargs="*", help="these folds alone")
    given = parser.parse_args()
    robot, parts, folds = read_folds(given)
    squares = {"whole": [], "2 s": []}
    for fold in given.only or range(given.folds):
        begun, busy = time.perf_counter(), time.process_time()
        training = Log.concatenate([p for p, f in zip(parts, folds, strict=True) if f != fold])
        answered = best_answer(pose(robot, training))
        data, found = answered.motions.data, answered.model
        took = time.perf_counter() - begun, time.process_time() - busy
        kept = [p for p, f in zip(parts, folds, strict=True) if f == fold]
        print(f"fold {fold}: fitted in {took[0]:.0f} s ({took[1]:.0f} s of one core)", flush=True)
        for name, seconds in (("whole", None), ("2 s", 2.0)):
            arm = ServoArm(robot, found.servos, data.scale)
            far_ones = replay(arm, kept, windows=seconds).simulated
            for real, far in zip(kept, far_ones, strict=True):
                square = (far.q - real.q).square()
                squares[name].append((real.names[0], square))
                rms = 1e3 * square.mean(0).sqrt()
                row = " ".join(f"{x:6.1f}" for x in rms.tolist())
                print(f"  {name:6s}{real.names[0]:30s}{row}  {float(rms.mean()):6.2f}", flush=True)
    for name, rows in squares.items():
        together = 1e3 * torch.cat([s for _, s in rows]).mean(0).sqrt()
        each = torch.stack([1e3 * s.mean(0).sqrt() for _, s in rows]).mean(0)
        for what, x in (("all rows", together), ("mean of motions", each)):
            row = " ".join(f"{v:6.2f}" for v in x.tolist())
            print(f"{name:6s}{what:18s}{row}  mean {float(x.mean()):.2f} mrad")


if __name__ == "__main__":
    main()
