"""The small changes of meaning that a module can suffer, by the operators of mutmut (https://mutmut.readthedocs.io)."""

import ast
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import UnionType

import libcst as cst
import libcst.matchers as m
from libcst.metadata import CodeRange, MetadataWrapper, PositionProvider
from mutmut.mutation import mutators


@dataclass(frozen=True)
class Change:
    """One change at one place of one module.

    Attributes:
        path: The module, relative to the project.
        line: Line at which the changed piece of source begins.
        operator: Name of the operator that made the change.
        lines: First and last line of the statement, without the body of a compound statement.
        body: First and last line of the function that uses the value; None for code that runs at import.
        names: Names that receive the value where the code runs at import.
        at_import: Whether the code runs when the module is imported.
        pieces: The piece of source, and what replaces it.
        source: The whole module after the change.
    """

    path: str
    line: int
    operator: str
    lines: tuple[int, int]
    body: tuple[int, int] | None
    names: tuple[str, ...]
    at_import: bool
    pieces: Callable[[], tuple[str, str]]
    source: Callable[[], str]

    @property
    def before(self) -> str:
        """The piece of source, on one line."""
        return self.pieces()[0]

    @property
    def after(self) -> str:
        """What replaces the piece, on one line."""
        return self.pieces()[1]


def changes_of(root: Path, path: str) -> list[Change]:
    """All changes of one module, in the order of the source.

    Left out is what no test should notice: docstrings, annotations, imports, decorators, assertions, `__repr__`,
    what is raised, logged, warned of or printed, help texts, formatted strings and strings with a blank in them.
    """
    wrapper = MetadataWrapper(cst.parse_module((root / path).read_text(encoding="utf-8")))
    visitor = _Visitor(path, wrapper.module)
    wrapper.visit(visitor)
    return visitor.changes


def is_a_change(before: str, after: str) -> bool:
    """Whether the changed source compiles and means something else than the original."""
    try:
        return ast.dump(ast.parse(before)) != ast.dump(ast.parse(after))
    except SyntaxError:
        return False


def _doubled(node: cst.Float) -> Iterator[cst.BaseExpression]:
    """A constant of half or double the size; mutmut adds 1, which is a metre where lengths are millimetres."""
    value = node.evaluated_value
    yield node.with_changes(value=repr(value * 2 if value else 1.0))
    if value:
        yield node.with_changes(value=repr(value / 2))


def _changed_count(node: cst.Integer) -> Iterable[cst.BaseExpression]:
    """One more, where that is another number; a count of ten or more is doubled or halved."""
    value = node.evaluated_value
    if value < 10:
        return mutators.operator_number(node)
    return (node.with_changes(value=str(value * 2)), node.with_changes(value=str(value // 2)))


def _negated(node: cst.If | cst.CompIf) -> Iterator[cst.CSTNode]:
    """The other branch; mutmut changes the operators within a condition only."""
    test = node.test.with_changes(lpar=[cst.LeftParen()], rpar=[cst.RightParen()])
    yield node.with_changes(test=cst.UnaryOperation(operator=cst.Not(), expression=test))


def _dropped_argument(node: cst.Call) -> Iterator[cst.CSTNode]:
    """A named argument is left to its default; mutmut also drops positional ones, which no test can miss."""
    for after in mutators.operator_arg_removal(node):
        if _named(after) < _named(node):
            yield after


def _swapped(node: cst.CSTNode) -> Iterator[cst.CSTNode]:
    """Operators swapped; a bound is moved only where whole numbers are compared, for a measured length never meets it.

    Other comparisons are turned into their opposite.
    """
    opposite = _OPPOSITES.get(type(getattr(node, "operator", None)))
    if opposite and isinstance(node, cst.ComparisonTarget) and not m.matches(node.comparator, _WHOLE):
        yield node.with_changes(operator=opposite())
    else:
        yield from mutators.operator_swap_op(node)


def _named(call: cst.Call) -> int:
    return sum(arg.keyword is not None and arg.keyword.value not in _GUARDS for arg in call.args)


def _changed_string(node: cst.SimpleString) -> Iterator[cst.CSTNode]:
    """The first change only: the same string in capitals says nothing more. Text for people has blanks."""
    if " " not in node.value:
        yield from list(mutators.operator_string(node))[:1]


_OPPOSITES: dict[type, type] = {
    cst.LessThan: cst.GreaterThanEqual,
    cst.LessThanEqual: cst.GreaterThan,
    cst.GreaterThan: cst.LessThanEqual,
    cst.GreaterThanEqual: cst.LessThan,
}
_WHOLE = m.Integer(value=m.MatchIfTrue(lambda value: value != "0")) | m.Call(func=m.Name("len"))
# Arguments that say again what is true anyway, mostly.
_GUARDS = ("dtype", "strict", "encoding")
_OPERATORS: tuple[tuple[type | UnionType, Callable[..., Iterable[cst.CSTNode]]], ...] = (
    (cst.Integer, _changed_count),
    (cst.Float, _doubled),
    (cst.SimpleString, _changed_string),
    (cst.Name, mutators.operator_name),
    (cst.AugAssign, mutators.operator_augmented_assignment),
    (cst.UnaryOperation, mutators.operator_remove_unary_ops),
    (cst.Call, _dropped_argument),
    (cst.Call, mutators.operator_symmetric_string_methods_swap),
    (cst.Call, mutators.operator_unsymmetrical_string_methods_swap),
    (cst.Lambda, mutators.operator_lambda),
    (cst.CSTNode, mutators.operator_keywords),
    (cst.CSTNode, _swapped),
    (cst.Match, mutators.operator_match),
    (cst.IfExp, mutators.operator_if_exp),
    (cst.If | cst.CompIf, _negated),
)
_TEXT = m.SimpleString() | m.ConcatenatedString() | m.FormattedString()
_TALK = m.Name("print") | m.Attribute(attr=m.Name("warn")) | m.Attribute(value=m.Name("log") | m.Name("logger"))
_WITHOUT_MEANING = (
    m.Annotation()
    | m.Import()
    | m.ImportFrom()
    | m.Decorator()
    | m.Assert()
    | m.Raise()
    | m.FormattedString()
    | m.Expr(value=_TEXT)
    | m.Expr(value=m.Call(func=_TALK))
    | m.FunctionDef(name=m.Name("__repr__") | m.Name("__str__"))
    | m.If(test=m.Name("TYPE_CHECKING"))
    | m.Assign(targets=[m.AssignTarget(target=m.Name("__all__"))])
    | m.Arg(keyword=m.Name("help"))
)
_MAYBE_WITHOUT = (
    *(cst.Annotation, cst.Import, cst.ImportFrom, cst.Decorator, cst.Assert, cst.Raise, cst.FormattedString),
    *(cst.Expr, cst.FunctionDef, cst.If, cst.Assign, cst.Arg),
)


class _Visitor(cst.CSTVisitor):
    METADATA_DEPENDENCIES = (PositionProvider,)

    def __init__(self, path: str, module: cst.Module) -> None:
        self.changes: list[Change] = []
        self._path, self._module = path, module
        self._above: list[cst.CSTNode] = []

    def on_visit(self, node: cst.CSTNode) -> bool:
        if isinstance(node, _MAYBE_WITHOUT) and m.matches(node, _WITHOUT_MEANING):
            return False
        for kind, operator in _OPERATORS:
            if self._above and isinstance(node, kind):
                for after in operator(node):
                    self.changes.append(
                        self._change(node, after, operator.__name__.removeprefix("operator_").strip("_"))
                    )
        self._above.append(node)
        return True

    def on_leave(self, original_node: cst.CSTNode) -> None:
        if self._above and self._above[-1] is original_node:
            self._above.pop()

    def _change(self, node: cst.CSTNode, after: cst.CSTNode, operator: str) -> Change:
        above = [*self._above, node]
        function = next((n for n in reversed(self._above) if isinstance(n, cst.FunctionDef)), None)
        is_default = function is not None and any(isinstance(n, cst.Param) for n in self._above)
        statement = next(
            n for n in reversed(above) if isinstance(n, cst.SimpleStatementLine | cst.BaseCompoundStatement)
        )
        targets = [n for n in self._above if isinstance(n, cst.Assign | cst.AnnAssign)] if function is None else []
        return Change(
            path=self._path,
            line=self._span(node)[0],
            operator=operator,
            lines=self._span(statement, header_only=True),
            body=self._span(function.body) if function is not None and is_default else None,
            names=tuple(name for target in targets for name in _names(target)),
            at_import=function is None or is_default,
            pieces=lambda: (self._shown(node), self._shown(after)),
            source=lambda: self._module.deep_replace(node, after).code,  # type: ignore[union-attr]
        )

    def _shown(self, node: cst.CSTNode, width: int = 160) -> str:
        shown = node.test if isinstance(node, cst.If | cst.CompIf) else node
        text = " ".join(self._module.code_for_node(shown).split())
        return text if len(text) <= width else text[: width - 3] + "..."

    def _span(self, node: cst.CSTNode, *, header_only: bool = False) -> tuple[int, int]:
        body = getattr(node, "body", None)
        span = self._range(node)
        if header_only and isinstance(body, cst.IndentedBlock):
            return span.start.line, max(span.start.line, self._range(body.body[0]).start.line - 1)
        return span.start.line, span.end.line

    def _range(self, node: cst.CSTNode) -> CodeRange:
        found = self.get_metadata(PositionProvider, node)
        assert isinstance(found, CodeRange)
        return found


def _names(assignment: cst.Assign | cst.AnnAssign) -> Iterator[str]:
    targets = [assignment.target] if isinstance(assignment, cst.AnnAssign) else [t.target for t in assignment.targets]
    for target in targets:
        yield from (name.value for name in m.findall(target, m.Name()) if isinstance(name, cst.Name))
