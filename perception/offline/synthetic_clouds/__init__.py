"""Training clouds made on the device: surface samples, sensor noise, masks, scenes."""
