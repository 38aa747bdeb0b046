"""What all trainings share: processes on several GPUs, the loop over images, logs, scenes read as they appear."""
