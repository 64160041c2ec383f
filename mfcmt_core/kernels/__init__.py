"""The pixel loops, compiled by numba and cached on disk; each has a numpy twin in the tests.

The cache lies beside the source where that is writable, otherwise in the user's cache folder; what an
installation has put beside the source is read in any case. numba keys it by CPU and source: another CPU or a
changed file compiles again (``mfcmt warmup``), nothing else does.
"""
