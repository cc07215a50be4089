"""A few words of MathML, enough to write the report's equations: strings in, string out."""

from __future__ import annotations


def math(*parts: str) -> str:
    """A displayed equation."""
    return f"<math display='block'>{''.join(parts)}</math>"


def ident(text: str) -> str:
    """An identifier."""
    return f"<mi>{text}</mi>"


def op(text: str) -> str:
    """An operator or a bracket."""
    return f"<mo>{text}</mo>"


def num(text: str) -> str:
    """A number."""
    return f"<mn>{text}</mn>"


def word(text: str) -> str:
    """A word set upright."""
    return f"<mtext>{text}</mtext>"


def space() -> str:
    """An em of space."""
    return "<mspace width='1em'/>"


def row(*parts: str) -> str:
    """Several parts as one."""
    return f"<mrow>{''.join(parts)}</mrow>"


def frac(above: str, below: str) -> str:
    """A fraction."""
    return f"<mfrac>{above}{below}</mfrac>"


def sqrt(inside: str) -> str:
    """A square root."""
    return f"<msqrt>{inside}</msqrt>"


def sub(base: str, below: str) -> str:
    """A subscript."""
    return f"<msub>{base}{below}</msub>"


def sup(base: str, above: str) -> str:
    """A superscript."""
    return f"<msup>{base}{above}</msup>"


def subsup(base: str, below: str, above: str) -> str:
    """A subscript and a superscript."""
    return f"<msubsup>{base}{below}{above}</msubsup>"


def over(base: str, above: str) -> str:
    """A sign above: a dot, a bar."""
    return f"<mover>{base}<mo>{above}</mo></mover>"


def under(base: str, below: str) -> str:
    """A sign with something below it."""
    return f"<munder>{base}{below}</munder>"
