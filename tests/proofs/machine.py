"""Runs a function of the firmware on unknown numbers: every path at once, each value a term of the solver.

A small part of C, that of the firmware's arithmetic: what is not in it raises an error. Where paths meet, a
variable becomes a choice between its values. A loop is unrolled until the solver shows that no path goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import z3
from pycparser import c_ast

from proofs.numbers import Integers, Number, Type, Words, known
from proofs.source import Program, nodes, stated_shift, stated_turns

_COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
INTEGERS = {
    "_Bool": Type(1),
    **{f"uint{bits}_t": Type(bits) for bits in (8, 16, 32, 64)},
    **{f"int{bits}_t": Type(bits, signed=True) for bits in (8, 16, 32, 64)},
}


@dataclass(frozen=True)
class Place:
    """Where a value is: a variable, and members or elements on the way down from it. An element that is not
    known before is a number."""

    variable: tuple[int, str]
    path: tuple[str | Number, ...] = ()

    def below(self, *steps: str | Number) -> Place:
        return Place(self.variable, (*self.path, *steps))

    def whole(self) -> Place:
        """Return the array, if this is an element of one."""
        return Place(self.variable, self.path[:-1])


Fields = dict[str, Any]
"""A structure or an array: values by the names of its members, or by the numbers of its elements. A union has
its first member."""


@dataclass(frozen=True)
class Table:
    """Constant words, any number of them."""

    word: Any
    type: Type


@dataclass(frozen=True)
class Obligation:
    """A formula that must hold, under everything known when the program was there."""

    known: tuple[Any, ...]
    claim: Any
    about: str


@dataclass
class Frame:
    """A call: its number, its function, and its returns. Each has a condition, a result and the memory."""

    number: int
    definition: Any = None
    types: dict[str, Any] = field(default_factory=dict)
    returned: list[tuple[Any, Any, Any]] = field(default_factory=list)


Summary = Callable[..., Any]
"""Stands for a called function: takes the machine and the arguments, returns the result."""


class Machine:
    """One run.

    Attributes:
        facts: What is known of the unknown numbers.
        obligations: What was met on the way and must be proved.
        given: Terms of the function's arguments, by name.
        after_turn: Called after each turn of a loop that has none within it.
    """

    def __init__(
        self,
        program: Program,
        arithmetic: type[Words | Integers],
        summaries: Mapping[str, Summary] | None = None,
    ) -> None:
        self.program = program
        self.arithmetic = arithmetic(self.claim)
        self.summaries = summaries or {}
        self.int = Type(program.variant.int_bits, signed=True)
        self.facts: list[Any] = []
        self.obligations: list[Obligation] = []
        self.given: dict[str, Any] = {}
        self.after_turn: Callable[[Machine], None] | None = None
        self._path: list[Any] = []
        self._memory: dict[tuple[int, str], Any] = {}
        self._frames: list[Frame] = [Frame(0)]
        self._names = 0

    # --- What proofs use ---

    def unknown(self, name: str, type_: Type) -> Number:
        """Return a number of this type with any value."""
        self._names += 1
        number, fact = self.arithmetic.unknown(f"{name}_{self._names}", type_)
        self.facts.append(fact)
        return number

    def unknown_of(self, declared: Any, name: str) -> Any:
        """Return an unknown value of a declared type: a number, or a structure of them."""
        return self._filled(declared, name, self.unknown)

    def _filled(self, declared: Any, name: str, number: Callable[[str, Type], Number]) -> Any:
        kind = self._resolve(declared)
        if kind == "void":
            return None
        if isinstance(kind, Type):
            return number(name, kind)
        if isinstance(kind, c_ast.PtrDecl):
            return self._pointer_to(kind.type, name)
        if isinstance(kind, c_ast.ArrayDecl):
            size = known(self.value(kind.dim).term)
            return {str(index): self._filled(kind.type, name, number) for index in range(size)}
        members = kind.decls
        if isinstance(kind, c_ast.Union) and not self._has_separate_members(kind):
            members = kind.decls[:1]
        return {each.name: self._filled(each.type, each.name, number) for each in members}

    @staticmethod
    def _has_separate_members(union: Any) -> bool:
        """Return whether the members of a union are kept apart here, as if it were a structure.

        This is so for mcp_asdf_received_t alone. A call uses its estimates or its sums, by the robot's
        filter, and never reads the one after writing the other: the contracts of receive and settle say so.
        """
        return "sums" in [member.name for member in union.decls]

    def _pointer_to(self, declared: Any, name: str) -> Place:
        """To something unknown: constant words may be any number of them."""
        kind = self._resolve(declared)
        if not isinstance(kind, Type) or "const" not in declared.quals:
            return self.at(name, self.unknown_of(declared, name))
        word = self.arithmetic.constant(0, kind).term.sort()
        return self.at(name, Table(z3.Function(f"{name}_{self._names}", word, word), kind)).below("0")

    def parameter_of(self, parameter: Any) -> Any:
        """Return an unknown argument: for an array, a pointer to its first element."""
        value = self.unknown_of(parameter.type, parameter.name)
        is_array = isinstance(parameter.type, c_ast.ArrayDecl)
        return self.at(parameter.name, value).below("0") if is_array else value

    def seen(self, value: Any) -> Any:
        """Return the solver's terms in a value and in what its pointers point to, by name."""
        if isinstance(value, Place):
            return self.seen(self.load(value.whole() if value.path[-1:] == ("0",) else value))
        if isinstance(value, dict):
            return {name: self.seen(each) for name, each in value.items()}
        return value.term if isinstance(value, Number) else value

    def constant_of(self, declared: Any, value: int) -> Number:
        """Return a known number of a declared type."""
        return self.arithmetic.constant(value, self._resolve(declared))

    def variable(self, name: str) -> Place:
        """Return a variable of the function that runs."""
        return Place((self._frames[-1].number, name))

    def declare(self, declaration: Any) -> None:
        """A variable of this type with any value."""
        self._declare(declaration.name, declaration.type, self.unknown_of(declaration.type, declaration.name))

    def at(self, name: str, value: Any) -> Place:
        """Return a pointer to a new variable with this value."""
        self._names += 1
        place = Place((0, f"{name}_{self._names}"))
        self._memory[place.variable] = value
        return place

    def load(self, place: Place) -> Any:
        value = self._memory[place.variable]
        for step in place.path:
            value = self._element(value, step)
        return value

    def _element(self, whole: Any, step: str | Number) -> Any:
        if isinstance(whole, Table):
            index = step if isinstance(step, Number) else self.arithmetic.constant(int(step), whole.type)
            word = Number(whole.word(self._converted(index, whole.type).term), whole.type)
            self.facts.append(self.arithmetic.fits(word))
            return word
        if isinstance(step, str):
            return whole[step]
        first, *others = whole.items()
        found = first[1]
        for at, each in others:
            found = _merged(self._is_at(step, at), each, found)
        return found

    def _is_at(self, index: Number, at: str) -> Any:
        return index.term == self.arithmetic.constant(int(at), index.type).term

    def know(self, formula: Any) -> None:
        """Add something that holds wherever the program gets here."""
        self.facts.append(z3.Implies(z3.And(self._path), formula) if self._path else formula)

    def claim(self, formula: Any, about: str) -> None:
        """Add something that must hold here."""
        if not z3.is_true(z3.simplify(formula)):
            self.obligations.append(Obligation(self.known_here(), formula, about))

    def known_here(self) -> tuple[Any, ...]:
        """Return the facts, and the conditions under which the program gets here."""
        return (*self.facts, *self._path)

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function; returns its result, None without one."""
        if name in self.summaries:
            return self.summaries[name](self, *arguments)
        definition = self.program.functions[name]
        self._names += 1
        frame, outside = Frame(self._names, definition), list(self._memory)
        self._frames.append(frame)
        for parameter, argument in zip(self.program.parameters(name), arguments, strict=True):
            self._declare(parameter.name, parameter.type, argument)
        depth = len(self._path)
        self.execute(definition.body)
        del self._path[depth:]
        self._frames.pop()
        for condition, _, memory in reversed(frame.returned):
            for key in outside:
                self._memory[key] = _merged(condition, memory[key], self._memory[key])
        return self._chosen(frame.returned)

    # --- Statements ---

    def execute(self, node: Any) -> None:
        getattr(self, f"_{type(node).__name__}", self._expression_statement)(node)

    def _expression_statement(self, node: Any) -> None:
        self.value(node)

    def _Compound(self, node: Any) -> None:  # noqa: N802
        for item in node.block_items or []:
            self.execute(item)

    def _DeclList(self, node: Any) -> None:  # noqa: N802
        for each in node.decls:
            self.execute(each)

    def _Decl(self, node: Any) -> None:  # noqa: N802
        value = None
        if isinstance(node.init, c_ast.InitList):
            value = self._initialised(self._resolve(node.type), node.init)
        elif node.init is not None:
            value = self.value(node.init)
        elif isinstance(node.type, c_ast.ArrayDecl):
            value = self.unknown_of(node.type, node.name)
        self._declare(node.name, node.type, value)

    def _Return(self, node: Any) -> None:  # noqa: N802
        frame = self._frames[-1]
        value = None if node.expr is None else self.value(node.expr)
        value = self._converted(value, self._resolve(frame.definition.decl.type.type))
        frame.returned.append((z3.And(self._path), value, dict(self._memory)))
        self._path.append(z3.BoolVal(False))

    def _If(self, node: Any) -> None:  # noqa: N802
        self._branch(
            self.truth(node.cond),
            lambda: self.execute(node.iftrue),
            lambda: None if node.iffalse is None else self.execute(node.iffalse),
        )

    def _For(self, node: Any) -> None:  # noqa: N802
        if node.init is not None:
            self.execute(node.init)
        self._turn(node, 0)

    def _While(self, node: Any) -> None:  # noqa: N802
        self._turn(node, 0)

    def _EmptyStatement(self, node: Any) -> None:  # noqa: N802
        """Nothing."""

    def _turn(self, node: Any, made: int) -> None:
        condition = z3.simplify(self.truth(node.cond))
        most = stated_turns(node)
        if z3.is_false(condition):
            return
        if made == most:
            self.claim(z3.Not(condition), f"at most {made} turns of the loop in line {node.coord.line}")
            return

        def go_on() -> None:
            self.execute(node.stmt)
            if self.after_turn is not None and not any(nodes(node.stmt, c_ast.For)):
                self.after_turn(self)
            if isinstance(node, c_ast.For):
                self.value(node.next)
            self._turn(node, made + 1)

        self._branch(condition, go_on, lambda: None)

    def _branch(self, condition: Any, then: Callable[[], None], otherwise: Callable[[], None]) -> None:
        condition = z3.simplify(condition)
        if z3.is_true(condition):
            then()
        elif z3.is_false(condition):
            otherwise()
        else:
            before = dict(self._memory)
            with self._under(condition) as after_first:
                then()
            after_then, self._memory = self._memory, before
            with self._under(z3.Not(condition)) as after_second:
                otherwise()
            self._memory = {
                key: _merged(condition, after_then[key], value)
                for key, value in self._memory.items()
                if key in after_then
            }
            self._path += after_first + after_second

    @contextmanager
    def _under(self, condition: Any) -> Iterator[list[Any]]:
        """On a path of its own; the list says afterwards what is known behind it: where the condition holds,
        that no return has ended the path."""
        depth, behind = len(self._path), list[Any]()
        self._path.append(condition)
        yield behind
        behind += [z3.Implies(condition, each) for each in self._path[depth + 1 :]]
        del self._path[depth:]

    @contextmanager
    def _only(self, condition: Any) -> Iterator[None]:
        """For a part of an expression: what it changes is changed only where the condition holds."""
        before = dict(self._memory)
        with self._under(condition):
            yield
        for key, value in before.items():
            self._memory[key] = _merged(condition, self._memory[key], value)

    # --- Expressions ---

    def value(self, node: Any) -> Any:
        """Return the value of an expression."""
        return getattr(self, f"_value_{type(node).__name__}")(node)

    def truth(self, node: Any) -> Any:
        """Return the formula that the expression is not 0."""
        if isinstance(node, c_ast.BinaryOp) and node.op in ("&&", "||"):
            left = self.truth(node.left)
            with self._only(left if node.op == "&&" else z3.Not(left)):
                right = self.truth(node.right)
            return z3.And(left, right) if node.op == "&&" else z3.Or(left, right)
        if isinstance(node, c_ast.UnaryOp) and node.op == "!":
            return z3.Not(self.truth(node.expr))
        if isinstance(node, c_ast.BinaryOp) and node.op in _COMPARISONS:
            left, right = self.value(node.left), self.value(node.right)
            return self.arithmetic.compare(node.op, *self._common(left, right))
        return self.value(node).term != 0

    def _value_Constant(self, node: Any) -> Number:  # noqa: N802
        digits = node.value.rstrip("uUlL")
        value = int(digits, 0)
        sizes = [Type(bits, signed) for bits in (self.int.bits, 32, 64) for signed in (True, False)]
        unsigned_only, may_be_unsigned = "u" in node.value.lower(), digits.startswith("0x")
        for type_ in sizes:
            allowed = not type_.signed if unsigned_only else type_.signed or may_be_unsigned
            if allowed and value <= type_.most:
                return self.arithmetic.constant(value, type_)
        raise NotImplementedError(node.value)

    def _value_ID(self, node: Any) -> Any:  # noqa: N802
        constant = self.program.constants.get(node.name)
        return self.load(self._place(node)) if constant is None else self.value(constant)

    def _value_StructRef(self, node: Any) -> Any:  # noqa: N802
        whole = self.value(node.name) if node.type == "." else self.load(self.value(node.name))
        return whole[node.field.name]

    def _value_ArrayRef(self, node: Any) -> Any:  # noqa: N802
        array, index = self.value(node.name), z3.simplify(self.value(node.subscript).term)
        if isinstance(array, Place) or not (z3.is_int_value(index) or z3.is_bv_value(index)):
            return self.load(self._place(node))
        return array[str(index.as_long())]

    def _value_Cast(self, node: Any) -> Any:  # noqa: N802
        kind, value = self._resolve(node.to_type.type), self.value(node.expr)
        return as_binary32(value) if kind == "float" else self._converted(value, kind)

    def _value_TernaryOp(self, node: Any) -> Any:  # noqa: N802
        condition = z3.simplify(self.truth(node.cond))
        if z3.is_true(condition) or z3.is_false(condition):
            return self.value(node.iftrue if z3.is_true(condition) else node.iffalse)
        with self._only(condition):
            first = self.value(node.iftrue)
        with self._only(z3.Not(condition)):
            second = self.value(node.iffalse)
        if isinstance(first, Number):
            first, second = self._common(first, second)
        return _merged(condition, first, second)

    def _value_UnaryOp(self, node: Any) -> Any:  # noqa: N802
        if node.op == "&":
            return self._place(node.expr)
        if node.op == "*":
            return self.load(self.value(node.expr))
        if node.op in ("++", "--", "p++", "p--"):
            before = self.value(node.expr)
            after = self._changed(node.expr, node.op[-1], self.arithmetic.constant(1, self.int))
            return before if node.op[0] == "p" else after
        if node.op == "!":
            return self._truth_value(self.truth(node))
        number = self._promoted(self.value(node.expr))
        operator, left = {"-": ("-", 0), "~": ("^", -1)}[node.op]
        return self.arithmetic.binary(operator, self.arithmetic.constant(left, number.type), number)

    def _value_BinaryOp(self, node: Any) -> Number:  # noqa: N802
        if node.op in ("&&", "||", *_COMPARISONS):
            return self._truth_value(self.truth(node))
        left, right = self.value(node.left), self.value(node.right)
        self._claim_stated(node, node.op, right)
        return self._combined(node.op, left, right)

    def _value_Assignment(self, node: Any) -> Any:  # noqa: N802
        if node.op != "=":
            by = self.value(node.rvalue)
            self._claim_stated(node, node.op[:-1], by)
            return self._changed(node.lvalue, node.op[:-1], by)
        return self.store(self._place(node.lvalue), self.value(node.rvalue))

    def _value_FuncCall(self, node: Any) -> Any:  # noqa: N802
        arguments, name = [self._argument(each) for each in node.args.exprs], node.name.name
        if name == "__builtin_clz":
            return self._count_leading_zeros(arguments[0])
        kinds = [self._resolve(each.type) for each in self.program.parameters(name)]
        return self.call(name, *map(self._converted, arguments, kinds))

    def _argument(self, node: Any) -> Any:
        """Return the value of an argument: of a local array, a pointer to its first element."""
        declared = self._frames[-1].types.get(node.name) if isinstance(node, c_ast.ID) else None
        if isinstance(declared, c_ast.ArrayDecl) and isinstance(self.load(self.variable(node.name)), dict):
            return self.variable(node.name).below("0")
        return self.value(node)

    def _count_leading_zeros(self, number: Number) -> Number:
        """gcc's and clang's, which leave it open for 0."""
        self.claim(number.term != 0, "leading zeros of 0")
        zeros = [self.arithmetic.constant(31 - place, self.int).term for place in range(32)]
        found = zeros[0]
        for place, each in enumerate(zeros):
            found = z3.If(z3.Extract(place, place, number.term) == 1, each, found)
        return Number(found, self.int)

    # --- Values and places ---

    def _place(self, node: Any) -> Place:
        if isinstance(node, c_ast.ID):
            return self.variable(node.name)
        if isinstance(node, c_ast.StructRef):
            whole: Place = self._place(node.name) if node.type == "." else self.value(node.name)
            return whole.below(node.field.name)
        if isinstance(node, c_ast.ArrayRef):
            return self._place_of_element(node)
        if isinstance(node, c_ast.UnaryOp) and node.op == "*":
            place = self.value(node.expr)
            assert isinstance(place, Place)
            return place
        raise NotImplementedError(f"{type(node).__name__} as a place")

    def _place_of_element(self, node: Any) -> Place:
        """Return the place of an element: of an array, or counted from where a pointer points to."""
        index = self.value(node.subscript)
        if isinstance(node.name, c_ast.StructRef) and node.name.field.name == "all":
            return self._place(node.name).below(str(known(index.term)))
        array = self.value(node.name)
        place = self._place(node.name) if isinstance(array, dict) else array.whole()
        start = 0 if isinstance(array, dict) else int(array.path[-1])
        constant = z3.simplify(index.term)
        if z3.is_int_value(constant) or z3.is_bv_value(constant):
            return place.below(str(start + constant.as_long()))
        assert start == 0, "a pointer into an array, and an unknown distance"
        elements = self.load(place)
        if isinstance(elements, dict):
            bounds = (self.arithmetic.constant(each, index.type) for each in (0, len(elements)))
            holds = map(self.arithmetic.compare, (">=", "<"), (index, index), bounds)
            self.claim(z3.And(*holds), "an element of the array")
        return place.below(index)

    def store(self, place: Place, value: Any) -> Any:
        if place.path[-2:-1] == ("all",):
            assert known(value.term) == 0, "long words of a union of bytes are cleared, nothing else"
            for byte in range(8 * int(str(place.path[-1])), 8 * int(str(place.path[-1])) + 8):
                self.store(Place(place.variable, (*place.path[:-2], "of", str(byte))), value)
            return value
        before = self.load(place)
        if isinstance(before, Number):
            value = self._converted(value, before.type)
        self._memory[place.variable] = self._replaced(self._memory[place.variable], place.path, value)
        return value

    def _replaced(self, whole: Any, path: tuple[str | Number, ...], value: Any) -> Any:
        if not path:
            return value
        step, *below = path
        if isinstance(step, str):
            return {**whole, step: self._replaced(whole[step], tuple(below), value)}
        return {
            at: _merged(self._is_at(step, at), self._replaced(each, tuple(below), value), each)
            for at, each in whole.items()
        }

    def _changed(self, target: Any, operator: str, by: Number) -> Any:
        place = self._place(target)
        return self.store(place, self._combined(operator, self.load(place), by))

    def _combined(self, operator: str, left: Number, right: Number) -> Number:
        if operator in ("<<", ">>"):
            return self.arithmetic.binary(operator, self._promoted(left), self._promoted(right))
        return self.arithmetic.binary(operator, *self._common(left, right))

    def _claim_stated(self, node: Any, operator: str, count: Number) -> None:
        """Claim that a shift's count is at most the bound in the comment beside it."""
        most = stated_shift(node) if operator in ("<<", ">>") else None
        if most is not None:
            limit = self.arithmetic.constant(most, count.type)
            self.claim(self.arithmetic.compare("<=", count, limit), f"a shift by at most {most}")

    def _promoted(self, number: Number) -> Number:
        return number if number.type.bits >= self.int.bits else self.arithmetic.convert(number, self.int)

    def _common(self, left: Number, right: Number) -> tuple[Number, Number]:
        left, right = self._promoted(left), self._promoted(right)
        bits = max(left.type.bits, right.type.bits)
        signed = all(each.type.signed for each in (left, right) if each.type.bits == bits)
        return self._converted(left, Type(bits, signed)), self._converted(right, Type(bits, signed))

    def _converted(self, value: Any, kind: Any) -> Any:
        """Return a number as one of this type; anything else as it is."""
        if not isinstance(kind, Type) or not isinstance(value, Number) or value.type == kind:
            return value
        return self.arithmetic.convert(value, kind)

    def _truth_value(self, condition: Any) -> Number:
        one, zero = (self.arithmetic.constant(value, self.int).term for value in (1, 0))
        return Number(z3.If(condition, one, zero), self.int)

    def _declare(self, name: str, declared: Any, value: Any) -> None:
        self._frames[-1].types[name] = declared
        self._memory[self._frames[-1].number, name] = self._converted(value, self._resolve(declared))

    def _initialised(self, kind: Any, node: Any) -> Any:
        if isinstance(kind, c_ast.Union):
            return self._union(node)
        members = {each.name: self._resolve(each.type) for each in kind.decls}
        found = self._filled(kind, "", lambda _, type_: self.arithmetic.constant(0, type_))
        for name, each in zip(members, node.exprs, strict=False):
            if isinstance(members[name], (Type, c_ast.PtrDecl)):
                found[name] = self._converted(self.value(each), members[name])
        return found

    def _union(self, node: Any) -> Fields:
        """The headers' two unions: a binary32 and its bits; a long word and its two halves on an AVR."""
        (given,) = node.exprs
        if isinstance(given, c_ast.Cast):
            return {"bits": Number(z3.fpToIEEEBV(self.value(given)), INTEGERS["int32_t"])}
        long, by = INTEGERS["uint64_t"], self.arithmetic.constant(32, self.int)
        if given.name[0].name == "both":
            both = self.value(given.expr)
            halves = (both, self.arithmetic.binary(">>", both, by))
            words = (self._converted(each, INTEGERS["uint32_t"]) for each in halves)
            return {"word": {str(index): each for index, each in enumerate(words)}}
        low, high = (self._converted(self.value(each), long) for each in given.expr.exprs)
        return {"both": self.arithmetic.binary("+", self.arithmetic.binary("<<", high, by), low)}

    def _resolve(self, declared: Any) -> Any:
        """Return the integer type, structure, union or pointer that is declared."""
        if isinstance(declared, c_ast.TypeDecl):
            return self._resolve(declared.type)
        if isinstance(declared, c_ast.IdentifierType):
            (*_, name) = declared.names
            if name in INTEGERS or name == "int":
                return INTEGERS.get(name, self.int)
            return self._resolve(self.program.types[name]) if name in self.program.types else name
        return self.int if isinstance(declared, c_ast.Enum) else declared

    def _chosen(self, returned: list[tuple[Any, Any, Any]]) -> Any:
        if not returned:
            return None
        found = returned[-1][1]
        for condition, value, _ in reversed(returned[:-1]):
            found = _merged(condition, value, found)
        return found


def as_binary32(number: Number) -> Any:
    """Return a signed word rounded to binary32, to nearest."""
    return z3.fpSignedToFP(z3.RNE(), number.term, z3.Float32())


def _merged(condition: Any, first: Any, second: Any) -> Any:
    """Return the first value where the condition holds, and the second elsewhere."""
    if first is second or first is None or second is None:
        return second if first is None else first
    if isinstance(first, Number):
        same = first.term.eq(second.term)
        return first if same else Number(z3.If(condition, first.term, second.term), first.type)
    if isinstance(first, dict):
        return {name: _merged(condition, first[name], second[name]) for name in first}
    assert first == second, "a pointer that depends on a condition"
    return first


def chosen(condition: Any, first: Any, second: Any) -> Any:
    """Return the first terms where the condition holds, the second elsewhere."""
    if isinstance(first, dict):
        return {name: chosen(condition, first[name], second[name]) for name in first}
    if isinstance(first, Table):
        return Table(lambda index: z3.If(condition, first.word(index), second.word(index)), first.type)
    return z3.If(condition, first, second)
