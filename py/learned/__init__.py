"""Learned surrogates: trained from recordings, deployed as Blocks that need numpy and CasADi only."""

from .block_file import Certificate, LearnedBlock, LearnedKind, learned_kinds, read_block, register_kind, write_block
from .gaussian.dual import learn_dual_gp
from .gaussian.single import learn_gaussian_process
from .grey_box.learn import learn_grey_box
from .hybrid.block import HybridBlock, read_hybrid, write_hybrid
from .hybrid.learn import learn_hybrid
from .inverse.compensator import learn_compensator
from .inverse.data import Characteristic, characteristic
from .inverse.learn import learn_inverse
from .learning import learn
from .network.learn import train_network
from .network.rate import learn_rate_network
from .piecewise.learn import learn_piecewise
from .published_formula import published_formula
from .state_network.learn import learn_state_network
from .symbolic.learn import learn_symbolic
from .training_data import DomainShare, domain_share

__all__ = [
    "Certificate",
    "Characteristic",
    "DomainShare",
    "HybridBlock",
    "LearnedBlock",
    "LearnedKind",
    "characteristic",
    "domain_share",
    "learn",
    "learn_compensator",
    "learn_dual_gp",
    "learn_gaussian_process",
    "learn_grey_box",
    "learn_hybrid",
    "learn_inverse",
    "learn_piecewise",
    "learn_rate_network",
    "learn_state_network",
    "learn_symbolic",
    "learned_kinds",
    "published_formula",
    "read_block",
    "read_hybrid",
    "register_kind",
    "train_network",
    "write_block",
    "write_hybrid",
]
