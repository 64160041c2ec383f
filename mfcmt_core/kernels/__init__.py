"""The pixel loops, compiled by numba and cached on disk; each has a numpy twin in the tests.

The cache lies beside the source where that is writable, otherwise in the user's cache folder, and numba keys
it by CPU and source time: another CPU or a changed file compiles again (``mfcmt warmup``), nothing else does.
"""
