"""What a job never imports: data sets, synthesis, training, evaluation, annotation, research. Extra: `train`."""
