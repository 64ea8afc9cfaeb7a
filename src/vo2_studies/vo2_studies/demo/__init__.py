"""The main job: identify, sense, track, record and replay on a real graph; ends in one report."""
