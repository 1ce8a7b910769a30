"""Numba's pipeline for the functions of kernels: one optimisation of all that a function calls.

Numba optimises each function and makes machine code of it, though its callers have it in their own modules
and optimise it again. A function of `Inner` has neither: those that call it from outside optimise it with all
others, once. Signatures of operations are kept, and passes that plain loops do not need are left out.

Importing this module imports Numba: only compiled code and what builds it may do so.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators, allow-subclassing-any, allow-untyped-calls

from __future__ import annotations

from typing import Any, ClassVar

from llvmlite.binding import Linkage
from numba import _dynfunc, types  # type: ignore[attr-defined]
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import (
    IRLegalization,
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.untyped_passes import (
    DeadBranchPrune,
    FixupArgs,
    GenericRewrites,
    IRProcessing,
    ReconstructSSA,
    TranslateByteCode,
)


class _InnerLibrary(JITCodeLibrary):
    """The code of one function as it was written, for the modules of its callers."""

    def add_llvm_module(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout
        self._final_module.link_in(ll_module)

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.external:
                function.linkage = Linkage.linkonce_odr  # its callers may have it several times
        self._finalized = True


class _OuterLibrary(JITCodeLibrary):
    """The code of one function with all that it calls, optimised together."""

    effort: ClassVar[dict[str, Any]] = {}

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal  # no other module calls it: inlined once, it is dropped
        # Numba's own has a pass before, for counts of references that are not here.
        passes, options = self._codegen._module_pass_manager(**self.effort)
        passes.run(self._final_module, options)


class _SeldomLibrary(_OuterLibrary):
    """The same, optimised little."""

    effort: ClassVar[dict[str, Any]] = {"opt": 1, "loop_vectorize": False}


class _TypingContext:
    """Numba's, which finds the signature of an operation anew each time; kept here."""

    signatures: ClassVar[dict[Any, Any]] = {}

    def __init__(self, context: Any) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def resolve_function_type(self, function: Any, arguments: Any, named: Any) -> Any:
        """Return the signature of a call."""
        if named or not isinstance(function, types.Function):
            return self._context.resolve_function_type(function, arguments, named)
        key = function, arguments
        if key not in self.signatures:
            self.signatures[key] = self._context.resolve_function_type(function, arguments, named)
        return self.signatures[key]


@register_pass(mutates_CFG=True, analysis_only=False)
class _Inference(NopythonTypeInference):
    _name = "exunet_inference"

    def run_pass(self, state: Any) -> bool:
        context = state.typingctx
        state.typingctx = _TypingContext(context)
        try:
            return bool(super().run_pass(state))
        finally:
            state.typingctx = context


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Lower a function into a library of its compiler's class."""

    _name = "exunet_lowering"

    def run_pass(self, state: Any) -> bool:
        library = state.pipeline.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library = library
        if not isinstance(library, _InnerLibrary):
            library.enable_object_caching()
            return bool(super().run_pass(state))
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        module, name = lowered.fndesc.lookup_module(), lowered.fndesc.qualname
        known_by = _dynfunc.make_function(module, name, "", 0, lowered.env, (library,))
        called = dict.fromkeys((library, *library._linking_libraries))
        state.targetctx.insert_user_function(known_by, lowered.fndesc, list(called))
        state["cr"] = lowered._replace(cfunc=known_by)
        return True


class Inner(CompilerBase):
    """Compiler of a function that is called in its module only."""

    library: ClassVar[type[JITCodeLibrary]] = _InnerLibrary

    def define_pipelines(self) -> list[Any]:
        manager = PassManager("exunet")
        for step in (
            TranslateByteCode,
            FixupArgs,
            IRProcessing,
            DeadBranchPrune,
            GenericRewrites,
            ReconstructSSA,
            _Inference,
            PreLowerStripPhis,
            IRLegalization,
            _Lowering,
            NoPythonBackend,
        ):
            manager.add_pass(step, step._name)
        manager.finalize()
        return [manager]


class Outer(Inner):
    """Compiler of a function that is called from outside its module."""

    library = _OuterLibrary


class Seldom(Inner):
    """Compiler of one that is called a few times a second at most."""

    library = _SeldomLibrary
