"""The synthetic data set: rendered RGB-D images of hand-held tools with end-effector masks, poses and clouds.

    toolee dataset generate --config hard --size 1000 --out data/hard
    from toolee_robot.perception.dataset.scene_reader import load
    images = load(Path("data/hard/train"))

`spec` (what is asked for), `example` (one example from its seed: scenes `hard`, `station`, `paper`), `scene_writer` and
`scene_reader` (BOP scenes), `generate` and `finish` (the folder), `validate`, `pictures`, `plots` and `shapes` (looking
at it).
"""
