"""A profile gives every sample of a training to one stage."""

import sys

from env.tools.profile import by_stage, without_folders

LEARN = (
    "<module> (env/tools/profile.py:1);train (env/tools/profile.py:80);learn (sb3/ppo/ppo.py:300)"
)
WORKER = "_worker (stable_baselines3/common/vec_env/subproc_vec_env.py:30);step (env/street/crossing.py:1)"
PERCEIVE = f"{WORKER};ScenePipeline.perceive (env/perception/pipeline.py:77)"


def test_samples_belong_to_the_innermost_stage_that_they_are_in():
    stages = by_stage(
        [
            "process 1;<module> (env/tools/profile.py:1);load (torch/__init__.py:1) 1000000",  # not yet
            f"{LEARN};collect (sb3/on_policy.py:1) 10000",
            f"{PERCEIVE};find_entities (vsr/entities.py:9) 200000",
            f"{WORKER};__call__ (env/perception/description.py:50) 30000",
            f"{WORKER};__call__ (env/perception/description.py:50);FeatureEncoder.encode (vsr/networks/autoencoder.py:99) 400000",
            f"{WORKER};reset (env/street/crossing.py:1);capture (env/world/camera.py:20) 600000",
            f"{WORKER};_drive (env/street/crossing.py:250) 50000",
        ]
    )
    whole = sum(stages.values())
    found = {stage: round(1290 * time / whole) for stage, time in stages.items() if time}
    other = next(stage for stage in found if stage.startswith("all else"))
    assert found == {
        "perception": 200,
        "descriptor": 30,
        "encoder": 400,
        "camera": 600,
        "people and physics": 50,
        other: 10,
    }


def test_a_flame_graph_tells_nothing_of_the_machine_s_folders():
    picture = without_folders(f"<text>{sys.executable} -m env.tools.profile train simulator</text>")
    assert picture.startswith("<text>python")
    assert picture.endswith(" -m env.tools.profile train simulator</text>")
