"""Compiled kinematics: CasADi functions of an arm, turned into machine code where there is a C compiler."""

from optsc.robot.kernels.build import compiler
from optsc.robot.kernels.inverse import search
from optsc.robot.kernels.kernel import BatchKernel, Kernel, build_batch_kernel, build_kernel
from optsc.robot.kernels.kinematics import forward_kinematics, jacobian, kinematics

__all__ = [
    "BatchKernel",
    "Kernel",
    "build_batch_kernel",
    "build_kernel",
    "compiler",
    "forward_kinematics",
    "jacobian",
    "kinematics",
    "search",
]
