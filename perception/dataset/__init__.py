"""The synthetic data set: rendered RGB-D images of hand-held tools with end-effector masks, poses and clouds.

    toolee dataset generate --config hard --size 1000 --out data/hard
    from toolee_robot.perception.dataset.scene_reader import load
    images = load(Path("data/hard/train"))

The format: `spec` (what is asked for), `scene_writer` and `scene_reader` (BOP scenes), `index_files` (the folder),
`validation`, `figures` (looking at it). Data sets are made by `toolee_robot.perception.synthesis`.
"""
