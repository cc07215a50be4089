"""How numbers are compiled: kernels that Python calls (numba's own `njit`), and the parts that only kernels call.

What a kernel calls in one place only is pasted into it before compiling (`inline="always"`): each function of its own,
and each level of calls, is one more to compile. What it calls in several places is a `part`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba.extending import register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])


def part(function: Function) -> Function:
    """A function that compiled code may call; called from Python it runs as plain Python.

    It is compiled with each kernel that calls it, and only so: neither the wrappers through which Python would call
    it nor files of its own are made, which is a quarter of a kernel's compile time.
    """
    return _part(function)


def summing(function: Function) -> Function:
    """A `part` whose sums of products may be taken in any order: vectors of the processor do it in fours."""
    return _part(function, fastmath={"reassoc", "contract"})


def _part(function: Function, **options: Any) -> Function:
    made: Function = register_jitable(
        error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, **options
    )(function)
    return made
