"""The pixel loops, compiled by numba and cached on disk. Each has a numpy twin in the tests.

The cache lies beside the source if that is writable, otherwise in the user's cache folder. A cache that an installation
has put beside the source is read in any case. Its keys are the CPU and the source file: kernels are compiled again
(``mfcmt warmup``) on another CPU or after a change, and only then.
"""
