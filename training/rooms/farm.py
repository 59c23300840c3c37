"""Makes rooms in the background, at the lowest priority, until it is stopped.

usage: farm.py start|stop|status|run [--out .cache/rooms] [--split train] [--mix generated=1,people=1] [--scenes SCENE,..] [--maps 0.1]
[--count N]

`start` detaches a process (`run` stays in the foreground) that makes and packs one room after the other: OUT/SPLIT/SEED from seeds and, in the
proportion of --mix, OUT/SPLIT/SCENE_SEED from rooms modeled by people (people.py, where its scenes are installed). `stop` lets it finish the
room in work; so does SIGTERM. A new start goes on after the last seed. Finished folders are never removed or overwritten; folders that begin with a
dot are unfinished and are made again. A worker process makes the rooms and is started again when it crashes. With less than 15 GB of free disk the farm stops.
OUT/farm.log is its log, OUT/farm.pid its process, OUT/manifest.jsonl the list of rooms."""

import argparse
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FLOOR = 15e9  # bytes of disk that stay free
TRIES = 3  # times that the making of a room may fail or be cut off
WORKER_ROOMS = 50  # rooms until a worker is replaced, as its memory grows
STOP, FULL = 0, 4  # exit codes of a worker: told to stop or done; disk full; any other is a crash


def parse_mix(text):
    """{"generated": 1, "people": 1} from "generated=1,people=1"."""
    mix = {}
    for part in text.split(","):
        name, _, weight = part.partition("=")
        if name not in ("generated", "people") or not weight.isdigit():
            raise argparse.ArgumentTypeError(f'--mix: wanted "generated=1,people=1" with whole numbers, got {part!r}')
        mix[name] = int(weight)
    if not sum(mix.values()):
        raise argparse.ArgumentTypeError("--mix: wanted a positive weight, got none")
    return mix


def parse_scenes(text):
    """["bathroom2", "staircase2"] from "bathroom2,staircase2", [] from "": all."""
    if not text:
        return []
    import people_scenes

    scenes = text.split(",")
    unknown = [scene for scene in scenes if scene not in people_scenes.SCENES]
    if unknown:
        raise argparse.ArgumentTypeError(f"wanted some of {', '.join(people_scenes.SCENES)}, got {unknown[0]!r}")
    return scenes


def jobs(mix, scenes):
    """(seed, scene) of all rooms in order; scene None means a generated room. Without scenes by people all rooms are generated."""
    cycle = ["generated"] * mix.get("generated", 0) + ["people"] * (mix.get("people", 0) if scenes else 0)
    cycle = cycle or ["generated"]
    counts = dict.fromkeys(("generated", "people"), 0)
    while True:
        for kind in cycle:
            number = counts[kind]
            counts[kind] += 1
            yield (number, None) if kind == "generated" else (number, scenes[number % len(scenes)])


def name(seed, scene):
    return f"{seed:06d}" if scene is None else f"{scene}_{seed:06d}"


def has_maps(seed, share):
    """Whether the room of a seed gets maps of incoming radiance: a fixed share of the seeds, evenly spread."""
    return int((seed + 1) * share) > int(seed * share)


class Farm:
    """The making of rooms under `out`. `render(seed, scene, folder, maps)` makes one and gives None where nothing is seen; `pack(folder)` adds sample.npz."""

    def __init__(self, out, split, render, pack, free=lambda path: shutil.disk_usage(path).free):
        self.out, self.split, self.render, self.pack, self.free = Path(out), split, render, pack, free

    def stopped(self):
        return (self.out / "farm.stop").exists()

    def run(self, queue, maps=0.0, count=None):
        """Makes rooms until a stop file, `count` rooms or a full disk; the exit code. A room whose making fails TRIES times is marked and passed over."""
        import make
        import manifest

        made = 0
        (self.out / self.split).mkdir(parents=True, exist_ok=True)
        for seed, scene in queue:
            folder = self.out / self.split / name(seed, scene)
            if folder.exists() and ((folder / "sample.npz").exists() or (folder / "skipped").exists()):
                continue
            tries = self.out / "farm.tries" / folder.name
            if tries.exists() and len(tries.read_text()) >= TRIES:
                continue
            if self.stopped() or (count is not None and made >= count):
                return STOP
            if self.free(self.out) < FLOOR:
                print(f"less than {FLOOR / 1e9:.0f} GB of free disk under {self.out}", flush=True)
                return FULL
            tries.parent.mkdir(exist_ok=True)
            with open(tries, "a") as log:
                log.write("x")
            began, cpu = time.time(), sum(os.times()[:4])
            if not folder.exists() and not make.finish(folder, lambda to: self.render(seed, scene, to, has_maps(seed, maps))):
                print(f"{folder.name} skipped", flush=True)
            elif (folder / "truth.npz").exists():
                self.pack(folder)
                manifest.append(self.out, folder, "sample.npz")
                print(f"{folder.name} made in {time.time() - began:.1f} s, {sum(os.times()[:4]) - cpu:.1f} s of CPU", flush=True)
            tries.unlink()
            made += 1
        return STOP


def lock(out):
    """The pid file, locked for as long as it stays open; None when another process holds it."""
    file = open(out / "farm.pid", "a+")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    file.truncate(0)
    file.write(f"{os.getpid()}\n")
    file.flush()
    return file


def running(out):
    """The process of the farm that holds the lock, or None."""
    try:
        with open(out / "farm.pid") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                return int(file.read() or 0)
    except FileNotFoundError:
        pass
    return None


def worker(args):
    """Makes up to WORKER_ROOMS rooms in this process."""
    sys.path[:0] = [str(HERE), str(HERE.parent / "demo")]
    signal.signal(signal.SIGTERM, lambda *_: (args.out / "farm.stop").touch())
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import drjit as dr

    import variant  # noqa: F401  (sets the variant)

    dr.set_thread_count(args.threads)
    import make
    import pack
    from assets import Library

    first, split, quality = make.SPLITS[args.split]
    library, scenes, people = Library.load(args.assets).only(split), [], None
    if args.mix.get("people"):
        try:
            import people

            installed = people.people_scenes.ARCHIVES.exists()
            scenes = (args.scenes or list(people.SCENES)) if installed else []
        except ImportError:
            print("people.py is not here: all rooms are generated", flush=True)

    def render(seed, scene, folder, maps):
        q = quality if maps else quality._replace(texel=0)
        try:
            if scene is None:
                return make.make(first + seed, library, folder, q)
            return people.make(scene, first + seed, library, folder, q)
        finally:
            dr.flush_malloc_cache()

    farm = Farm(args.out, args.split, render, lambda folder: pack.pack_room(folder, args.relight))
    left = WORKER_ROOMS if args.count is None else min(args.count, WORKER_ROOMS)
    return farm.run(jobs(args.mix, scenes), args.maps, left)


def run(args):
    """Starts workers one after the other until one is told to stop."""
    args.out.mkdir(parents=True, exist_ok=True)
    held = lock(args.out)
    if held is None:
        print(f"farm.py: process {running(args.out)} already makes rooms in {args.out}")
        return 1
    (args.out / "farm.stop").unlink(missing_ok=True)
    os.nice(19)
    stop = lambda *_: (args.out / "farm.stop").touch()
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    left, crashes = args.count, 0
    while not (args.out / "farm.stop").exists() and (left is None or left > 0):
        count = [] if left is None else ["--count", str(min(left, WORKER_ROOMS))]
        began = time.time()
        code = subprocess.call([sys.executable, __file__, "worker", *same(args), *count], start_new_session=True, pass_fds=())
        left = left if left is None or code else left - WORKER_ROOMS
        if code == FULL:
            break
        crashes = 0 if not code or time.time() - began > 600 else crashes + 1
        if code:
            print(f"farm.py: a worker ended with status {code}; another one follows", flush=True)
            time.sleep(min(5 * 2**crashes, 600))
    print("farm.py: stopped", flush=True)
    return 0


def same(args):
    mix = ",".join(f"{k}={v}" for k, v in args.mix.items())
    named = dict(out=args.out, split=args.split, mix=mix, scenes=",".join(args.scenes), maps=args.maps)
    named |= dict(assets=args.assets, relight=args.relight, threads=args.threads)
    return [str(x) for k, v in named.items() for x in (f"--{k}", v)]


def start(args):
    args.out.mkdir(parents=True, exist_ok=True)
    if running(args.out):
        print(f"farm.py: process {running(args.out)} already makes rooms in {args.out}")
        return 1
    count = [] if args.count is None else ["--count", str(args.count)]
    with open(args.out / "farm.log", "a") as log:
        child = subprocess.Popen(
            [sys.executable, __file__, "run", *same(args), *count], stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )
    for _ in range(50):
        time.sleep(0.1)
        if running(args.out) or child.poll() is not None:
            break
    print(f"farm.py: process {child.pid} makes rooms in {args.out}; its log is {args.out / 'farm.log'}")
    return 0 if child.poll() in (None, 0) else 1


def stop(args):
    pid = running(args.out)
    if pid is None:
        print(f"farm.py: nothing makes rooms in {args.out}")
        return 0
    (args.out / "farm.stop").touch()
    print(f"farm.py: process {pid} stops after the room in work")
    return 0


def status(args):
    import manifest

    lines = [line for (_, file), line in manifest.read(args.out).items() if file == "sample.npz"]
    scenes = {}
    for line in lines:
        scenes[line["scene"]] = scenes.get(line["scene"], 0) + 1
    pid = running(args.out)
    print(f"{'process ' + str(pid) + ' makes rooms' if pid else 'nothing makes rooms'} in {args.out}")
    print(f"{len(lines)} rooms packed" + "".join(f", {scene} {number}" for scene, number in sorted(scenes.items())))
    print(f"{shutil.disk_usage(args.out).free / 1e9:.0f} GB of free disk" if args.out.exists() else "no folder yet")
    log = args.out / "farm.log"
    if log.exists():
        print("".join(log.read_text(errors="replace").splitlines(True)[-3:]), end="")
    return 0


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("action", choices=["start", "stop", "status", "run", "worker"])
    ask.add_argument("--out", type=lambda p: Path(p).resolve(), default=(ROOT / ".cache/rooms"))
    ask.add_argument("--split", choices=["train", "val", "test"], default="train")
    ask.add_argument("--mix", type=parse_mix, default=parse_mix("generated=1,people=1"))
    ask.add_argument("--scenes", default=[], type=parse_scenes, help="the third-party scenes of --mix; all unless told")
    ask.add_argument("--maps", type=float, default=0.1, help="share of the rooms that get maps of incoming radiance")
    ask.add_argument("--count", type=int, help="rooms until the farm stops by itself")
    ask.add_argument("--assets", type=lambda p: Path(p).resolve(), default=ROOT / ".cache/assets")
    ask.add_argument("--relight", type=lambda p: Path(p).resolve(), default=ROOT / "target/release/relight")
    ask.add_argument("--threads", type=int, default=1)
    args = ask.parse_args()
    sys.exit({"start": start, "stop": stop, "status": status, "run": run, "worker": worker}[args.action](args))


if __name__ == "__main__":
    main()
