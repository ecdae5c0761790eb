"""Learned surrogates: trained from recordings, deployed as Blocks that need numpy and CasADi only."""

from .block_file import Certificate, LearnedBlock, LearnedKind, learned_kinds, read_block, register_kind, write_block
from .network import train_network
from .published_formula import published_formula
from .training_data import DomainShare, domain_share

__all__ = [
    "Certificate",
    "DomainShare",
    "LearnedBlock",
    "LearnedKind",
    "domain_share",
    "learned_kinds",
    "published_formula",
    "read_block",
    "register_kind",
    "train_network",
    "write_block",
]
