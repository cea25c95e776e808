"""Claims of the paper's sections III to VI, each with its words, where they stand, what is compared, and how
many comparisons must hold; docs/reproduce.md says how comparisons are decided.

``questions of a user`` map what a user wants to know to the claims that answer it.
"""

from mcp_asdf_tools.reproduction.claims.asdf_minus import ASDF_MINUS
from mcp_asdf_tools.reproduction.claims.asdf_plus import ASDF_PLUS
from mcp_asdf_tools.reproduction.claims.baseline import BASELINE
from mcp_asdf_tools.reproduction.claims.factors import FACTORS
from mcp_asdf_tools.reproduction.claims.physical import PHYSICAL_EXPERIMENT

CLAIMS = (*FACTORS, *BASELINE, *ASDF_MINUS, *ASDF_PLUS, *PHYSICAL_EXPERIMENT)
"""In the order in which they stand in the paper."""

__all__ = ["CLAIMS"]
