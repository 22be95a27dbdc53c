"""Time to render an image of each preset, one core: the target is 0.15 s at 640 × 480.

Run: OMP_NUM_THREADS=1 python benchmarks/rendering.py
"""

import time

from pivometer.simulation import PRESETS, simulate

KINDS = ("board", "intrinsics", "shaft")


def main() -> None:
    """Print the minimum and mean processor time of an image, and of what comes before."""
    print(f"{'preset':10}{'what':12}{'min s':>8}{'mean s':>8}")
    for name in PRESETS:
        start = time.process_time()
        session = simulate(name, poses=8, board_pairs=4, single_views=2)
        print(f"{name:10}{'set-up':12}{time.process_time() - start:8.3f}")
        for camera in session.rig.cameras:
            start = time.process_time()
            session.renderer(camera.name)
            print(f"{name:10}{camera.name:12}{time.process_time() - start:8.3f}")
        for kind in KINDS:
            times = []
            for path in session.paths:
                if path.startswith(kind):
                    start = time.process_time()
                    session.image(path)
                    times.append(time.process_time() - start)
            print(f"{name:10}{kind:12}{min(times):8.3f}{sum(times) / len(times):8.3f}")


if __name__ == "__main__":
    main()
