"""The synthetic data set: rendered RGB-D images of hand-held tools with end-effector masks and poses.

python -m toolee_robot.perception.dataset.generate data/train --size 4096 --seed 1 --workers 4
python -m toolee_robot.perception.dataset.inspect data/train montage.png
"""
