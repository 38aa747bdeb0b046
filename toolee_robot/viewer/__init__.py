"""Pages in the browser: a station, a run that is over, a run that goes on; and videos of runs."""
