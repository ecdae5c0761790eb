"""Opening of one metering edge against spool position."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Law, Parameter


class MeteringEdgeLaw(Law):
    """``o = opening(x)`` [1] for the spool's displacement ``x`` [1] in the direction that opens the edge."""

    def opening(self, x):
        """Opening [1] at displacement ``x`` [1]; zero when closed."""
        raise NotImplementedError


class ZeroOverlapEdge(MeteringEdgeLaw):
    """o = max(x, 0): the edge opens at the spool's centre. Source: Merritt (1967), critical-centre valve."""

    def opening(self, x):
        return ca.fmax(x, 0)


class OverlappedEdge(MeteringEdgeLaw):
    """o = max(x - overlap, 0): the spool covers the edge by ``overlap``. Source: Merritt (1967), section 5.5."""

    overlap = Parameter(0.05, "1", "overlap of the edge; negative: open centre", bounds=(-0.5, 0.5), source="Merritt")

    def opening(self, x):
        return ca.fmax(x - self.overlap, 0)
