"""`toolee station`: the station file of a lab."""
