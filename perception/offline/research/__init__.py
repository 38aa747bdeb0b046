"""Research: the paper's estimator, and classical ones to compare with."""

HOW_TO_TRAIN = """\
  toolee dataset generate --config hard --sensor mixed --size 12000 --seed 41 --test-share 0 --out data/paper-arm
  toolee train clouds data/paper-arm/train --true-masks --out runs/paper-arm.npz
  toolee train paper runs/paper-arm.npz --minutes 30 --out runs/paper-arm"""
"""How the paper's estimator is trained for a job. `hard` images, because a job's camera has a sensor's errors. The
weights are not shipped. Here, because a message needs no networks' libraries."""
