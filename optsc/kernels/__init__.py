"""Compiled kernels: CasADi functions of an arm, turned into machine code where there is a C compiler.

They take an arm as small arrays (`Chain`, `LinkCapsules`, limits), so this room knows nothing of robot descriptions.
"""

from optsc.kernels.build import compiler
from optsc.kernels.chain import Chain, forward_kinematics, kinematics
from optsc.kernels.kernel import BatchKernel, Kernel, build_batch_kernel, build_kernel

__all__ = [
    "BatchKernel",
    "Chain",
    "Kernel",
    "build_batch_kernel",
    "build_kernel",
    "compiler",
    "forward_kinematics",
    "kinematics",
]
