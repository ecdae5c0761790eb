"""Learned surrogates: trained from recordings, deployed as Blocks that need numpy and CasADi only."""

from .bands import band_of
from .block_file import Certificate, LearnedBlock, LearnedKind, learned_kinds, read_block, register_kind, write_block
from .gaussian.choice import learn_gp
from .gaussian.dual import learn_dual_gp
from .gaussian.feedback import learn_feedback_gp
from .gaussian.single import learn_gaussian_process
from .grey_box.learn import learn_grey_box
from .hybrid.block import HybridBlock
from .hybrid.files import read_hybrid, write_hybrid
from .hybrid.learn import learn_hybrid
from .inverse.compensator import learn_compensator
from .inverse.data import Characteristic, characteristic
from .inverse.judging import judged_compensator, judged_inverse
from .inverse.learn import learn_inverse
from .learning import learn
from .linear.arx import learn_arx
from .linear.learn import learn_linear
from .network.learn import train_network
from .network.rate import learn_rate_network
from .piecewise.learn import learn_piecewise
from .polynomial.learn import learn_narx
from .published_formula import published_formula
from .ranking import learn_best
from .refit import refitted
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
    "band_of",
    "characteristic",
    "domain_share",
    "judged_compensator",
    "judged_inverse",
    "learn",
    "learn_arx",
    "learn_best",
    "learn_compensator",
    "learn_dual_gp",
    "learn_feedback_gp",
    "learn_gaussian_process",
    "learn_gp",
    "learn_grey_box",
    "learn_hybrid",
    "learn_inverse",
    "learn_linear",
    "learn_narx",
    "learn_piecewise",
    "learn_rate_network",
    "learn_state_network",
    "learn_symbolic",
    "learned_kinds",
    "published_formula",
    "read_block",
    "read_hybrid",
    "refitted",
    "register_kind",
    "train_network",
    "write_block",
    "write_hybrid",
]
