"""`qdgrasp bench`: what a node makes of evaluations."""

import signal

from tests.patience import PATIENCE
from tests.system.commands import is_alive, processes_of, wait_for

BENCH = ("bench", "--object", "tennis_ball", "--seconds", "0.2")


def test_bench_measures_one_worker_and_all_and_leaves_nothing(qdgrasp):
    done = qdgrasp(*BENCH, "--workers", 2, "--json")
    assert done.code == 0, done.err
    (scene,) = done.json["scenes"]
    assert (scene["gripper"], scene["object"], scene["protocol"]) == ("panda", "tennis_ball", "paper")
    assert [(pace["regime"], pace["workers"]) for pace in scene["paces"]] == [
        ("anywhere", 1),
        ("near grasps", 1),
        ("anywhere", 2),
        ("near grasps", 2),
    ]
    anywhere, near = scene["paces"][:2]
    assert anywhere["per_cpu_second"] > near["per_cpu_second"]
    assert anywhere["success_share"] < 0.3 < near["success_share"]
    assert scene["memory_bytes"] > 50e6
    assert scene["start_seconds"] > 0
    assert set(scene["run_seconds"]) == set(scene["scaling"]) == {"anywhere", "near grasps"}
    assert len(done.json["platform"]["probes"]) == 64
    assert [path.name for path in qdgrasp.home.iterdir()] == ["cache"]


def test_a_person_gets_a_table_and_one_worker_has_nothing_to_scale(qdgrasp):
    done = qdgrasp(*BENCH, "--workers", 1)
    assert done.code == 0, done.err
    assert "panda on tennis_ball" in done.out
    assert "10,000 evaluations take" in done.out
    assert "scaling" not in done.out


def test_ctrl_c_ends_it_with_all_its_workers(qdgrasp):
    process = qdgrasp.start("bench", "--object", "tennis_ball", "--workers", 2, "--seconds", 600)
    workers = wait_for(lambda: processes_of(process.pid), "a worker").values()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out) == (130, ""), err
    wait_for(lambda: not any(map(is_alive, workers)), "their end")


def test_a_name_that_is_not_there_is_refused_before_anything_starts(qdgrasp):
    done = qdgrasp(*BENCH, "--gripper", "pandas")
    assert done.code == 2
    assert "pandas" in done.err
    assert done.out == ""
