"""`longreach bench bundle`: our bundle adjustment, gtsam's and SciPy's on the same stereo data, judged by one cost."""
