"""How the functions of this package are compiled: all of them in one go, as parts of the one that Python calls.

numba optimises a function and makes machine code of it, and again in each of its callers, up to the last: most of
the time of a first start. Nobody calls the functions here from Python, so the `compiled` ones are only lowered to
LLVM's language; what calls them brings them along, and `run` is optimised once, with everything in it.

numba also compiles a function anew for each integer literal among its arguments: `np.intp(0)` is none.
"""

from __future__ import annotations

from typing import Any

from numba import njit
from numba._dynfunc import make_function
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering

FLOATS = {"contract", "nsz"}
"""What may be done to arithmetic: multiply and add at once, and lose the sign of a zero."""


class LoweredLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code that is neither optimised nor made machine code by itself, to be linked into that of its callers."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        return

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class LowerForCallers(NativeLowering):  # type: ignore[misc]
    """Lowers a function into a `LoweredLibrary`, for its callers; Python cannot call it."""

    _name = "lower_for_callers"

    def run_pass(self, state: Any) -> bool:
        """Lower the function of `state`."""
        name, context = state.func_id.func_qualname, state.targetctx
        state.library = LoweredLibrary(context.codegen(), name)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        # callers find the code under the object that Python would call
        module, address = lowered.fndesc.lookup_module(), 0
        entry = make_function(module, name, "", address, lowered.env, (state.library,))
        context.insert_user_function(entry, lowered.fndesc, [state.library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


class ForCallers(CompilerBase):  # type: ignore[misc]
    """numba's own passes, but for the lowering."""

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
            (LowerForCallers, told) if step is NativeLowering else (step, told) for step, told in passes.passes
        ]
        passes.finalize()
        return [passes]


def _for_callers(fastmath: Any) -> Any:
    return njit(
        pipeline_class=ForCallers,
        nogil=True,
        fastmath=fastmath,
        error_model="numpy",
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
    )


compiled: Any = _for_callers(FLOATS)
compiled_fast: Any = _for_callers(True)
"""For largest values, which vectorise in no given order."""


@compiled
def copy(source, target):
    """Copy a row; a loop compiles in a fraction of the time that an assignment of slices takes."""
    for i in range(source.size):
        target[i] = source[i]


@compiled
def copy_state(states, now):
    """Copy state `now` to slot 0."""
    for row in range(states.shape[1]):
        copy(states[now, row], states[0, row])
