"""How the functions of this package are compiled: as parts of the one that Python calls.

numba optimises a function as a module, makes machine code of it, and does so again in each of its callers, up
to the last: most of the time of a first start. Nobody calls the functions here from Python, so the `compiled`
ones are lowered to LLVM's language and simplified one by one; what calls them brings them along, and `run` is
optimised as a module and made machine code once, with everything in it. Long loops over nodes vectorise
better before they are inlined: the `vectorised` functions, which call few others, are optimised as modules of
their own too.

numba also compiles a function anew for each integer literal among its arguments: `np.intp(0)` is none.
"""

from __future__ import annotations

from typing import Any, ClassVar

from numba import njit
from numba._dynfunc import make_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering

FLOATS = {"contract", "nsz"}
"""What may be done to arithmetic: multiply and add at once, and lose the sign of a zero."""
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


class VectorisedLibrary(JITCodeLibrary):
    """Code that is not made machine code by itself, to be linked into that of its callers."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class LoweredLibrary(VectorisedLibrary):
    """Such code that is not optimised as a module either."""

    def _optimize_final_module(self) -> None:
        return


@register_pass(mutates_CFG=True, analysis_only=False)
class LowerForCallers(NativeLowering):
    """Lowers a function into a library for its callers; Python cannot call it."""

    _name = "lower_for_callers"
    library: ClassVar[type[VectorisedLibrary]] = LoweredLibrary

    def run_pass(self, state: Any) -> bool:
        """Lower the function of `state`; True, as the state was changed (numba's contract of a pass)."""
        name, context = state.func_id.func_qualname, state.targetctx
        state.library = self.library(context.codegen(), name)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        # callers find the code under the object that Python would call
        module, address = lowered.fndesc.lookup_module(), 0
        entry = make_function(module, name, "", address, lowered.env, (state.library,))
        context.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class VectoriseForCallers(LowerForCallers):
    """The same into code optimised as a module of its own."""

    _name = "vectorise_for_callers"
    library = VectorisedLibrary


class ForCallers(CompilerBase):
    """numba's own passes, but for the lowering."""

    lowering: ClassVar[type[LowerForCallers]] = LowerForCallers

    def define_pipelines(self) -> list[Any]:
        """The passes."""
        passes = PassManager("for callers")
        builder = DefaultPassBuilder
        for part in (
            builder.define_untyped_pipeline(self.state),
            builder.define_typed_pipeline(self.state),
            builder.define_nopython_lowering_pipeline(self.state),
        ):
            passes.passes.extend(part.passes)
        passes.passes = [
            (self.lowering, told) if step is NativeLowering else (step, told) for step, told in passes.passes
        ]
        passes.finalize()
        return [passes]


class VectorisedForCallers(ForCallers):
    """The same, vectorised by itself."""

    lowering = VectoriseForCallers


def _for_callers(pipeline: type[ForCallers], fastmath: Any) -> Any:
    return njit(pipeline_class=pipeline, fastmath=fastmath, **{**OPTIONS, "no_cpython_wrapper": True})


compiled: Any = _for_callers(ForCallers, FLOATS)
vectorised: Any = _for_callers(VectorisedForCallers, FLOATS)
vectorised_maximum: Any = _for_callers(VectorisedForCallers, True)
"""For largest values, which vectorise only when they may be found in any order."""


@compiled
def copy(source, target):
    """Copy a row: a loop, as an assignment of slices compiles all of broadcasting."""
    for i in range(source.size):
        target[i] = source[i]


@compiled
def copy_state(states, now):
    """Copy state `now` to slot 0, in place; nothing is returned."""
    for row in range(states.shape[1]):
        copy(states[now, row], states[0, row])
