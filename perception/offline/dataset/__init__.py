"""The synthetic data set: rendered RGB-D images of hand-held tools with end-effector masks, poses and clouds.

    toolee dataset generate --config hard --size 1000 --out data/hard
    from toolee_robot.perception.offline.dataset.scenes import load
    images = load(Path("data/hard/train"))

Modules: `spec` (specification), `scenes` (BOP scenes), `index_files` (files of the whole data
set), `validate`, `figures` (inspection). `toolee_robot.perception.offline.synthesis` generates data sets.
"""
