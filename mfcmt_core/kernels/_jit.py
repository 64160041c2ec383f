"""How kernels are compiled, and where compiled kernels are kept and found."""

# mypy: allow-untyped-calls
from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numba
from llvmlite.binding import Linkage
from numba.core import caching
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

from . import cpu

cpu.fit()


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``function`` as a kernel: compiled on its first call, run without the GIL, cached on disk.

    ``fastmath`` allows sums to be vectorized. The inputs are finite by construction.
    """
    compiled = numba.njit(fastmath=True, nogil=True, error_model="numpy", pipeline_class=_Compiler)
    dispatcher: Any = compiled(function)
    dispatcher._cache = _Cache(function)
    return cast("Callable[..., Any]", dispatcher)


class _Compiler(Compiler):
    """Compiles a kernel so that it gives the same bits in every process.

    ``noalias`` promises that the arrays passed to a kernel do not overlap, so that its loops need not test for it.
    """

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        self.state.flags.noalias = True
        self.state.library = _SelfContained(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class _SelfContained(JITCodeLibrary):
    """Machine code that calls its own copies of the kernels it uses.

    A kernel holds an optimized copy of each kernel that it calls. numba lets the linker replace these copies: if the
    process has loaded the called kernel too, as after compiling it, the linker takes that one, which rounds
    differently. A private copy cannot be replaced.
    """

    def _finalize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
        super()._finalize_final_module()


class _Ready:
    """Mixin for a cache folder that need not be writable. numba itself ignores a cache that it cannot write."""

    def ensure_cache_path(self) -> None:
        pass


class _ReadyWhereTold(_Ready, caching.UserProvidedCacheLocator):
    pass


class _ReadyBesideSource(_Ready, caching.InTreeCacheLocator):
    pass


class _ReadyImpl(caching.CompileResultCacheImpl):
    _locator_classes: list[type[object]] = [_ReadyWhereTold, _ReadyBesideSource]  # noqa: RUF012


class _ReadyCache(caching.FunctionCache):
    _impl_class = _ReadyImpl


class _Cache:
    """numba's cache of one function, followed by the read-only cache of the installation.

    The second is what was put into ``NUMBA_CACHE_DIR``, or else beside the source, when the package was installed. A
    kernel that is in neither is compiled, and kept in memory only if no folder is writable.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self._own: Any = caching.NullCache()
        self._ready: Any = caching.NullCache()
        with contextlib.suppress(RuntimeError):  # numba finds no writable place
            self._own = caching.FunctionCache(function)
        ready: Any = _ReadyCache(function)
        if Path(ready.cache_path, f"{ready._impl.filename_base}.nbi").exists():
            self._ready = ready

    @property
    def cache_path(self) -> str | None:
        path: str | None = self._own.cache_path or self._ready.cache_path
        return path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        own = self._own.load_overload(sig, target_context)
        return own if own is not None else self._ready.load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(OSError):  # a full disk, or a process that may not write any more
            self._own.save_overload(sig, data)
