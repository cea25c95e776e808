"""Symbolic execution: run a function of the firmware on unknown numbers, on all paths at once.

A value is a term of the solver instead of a number. The machine knows the small part of C that the firmware
uses; anything else raises an error. A value in memory is one of these:

- a ``Number``
- a ``Location``, which stands for a pointer
- a ``ConstantTable``
- a dictionary for a structure or an array: values by the names of members, or by the indices of elements as
  text. A union has its first member alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import z3
from pycparser import c_ast

from proofs.numbers import (
    BitVectorArithmetic,
    IntegerArithmetic,
    IntegerType,
    Number,
    constant_value,
    is_constant,
)
from proofs.source import Program, documented_max_shift, documented_max_turns, nodes

_COMPARISON_SYMBOLS = ("<", "<=", ">", ">=", "==", "!=")
INTEGER_TYPES = {
    "_Bool": IntegerType(1),
    **{f"uint{bits}_t": IntegerType(bits) for bits in (8, 16, 32, 64)},
    **{f"int{bits}_t": IntegerType(bits, signed=True) for bits in (8, 16, 32, 64)},
}


@dataclass(frozen=True)
class Location:
    """The location of a value in memory: a variable, or a member or element of it.

    Attributes:
        variable: The number of the call that declares the variable, and its name.
        path: Members and elements on the way down from the variable. The index of an element is text, or a
            number if it is not a constant.
    """

    variable: tuple[int, str]
    path: tuple[str | Number, ...] = ()

    def select(self, *steps: str | Number) -> Location:
        """Return the location of a member or element, some steps further down."""
        return Location(self.variable, (*self.path, *steps))

    def enclosing_array(self) -> Location:
        """Return the array of which this is an element."""
        return Location(self.variable, self.path[:-1])


@dataclass(frozen=True)
class ConstantTable:
    """An array of constant words, any number of them.

    Attributes:
        word_at: Takes the term of an index, and returns the term of the word there.
        word_type: The type of each word, and of indices.
    """

    word_at: Any
    word_type: IntegerType


@dataclass(frozen=True)
class Obligation:
    """A claim that must hold under everything that is known where the program makes it."""

    assumptions: tuple[Any, ...]
    claim: Any
    description: str


@dataclass(frozen=True)
class Return:
    """A return statement that the program reached: under which condition, with which result and memory."""

    path_condition: Any
    result: Any
    memory: dict[tuple[int, str], Any]


@dataclass
class CallFrame:
    """A call of a function.

    Attributes:
        call_number: Tells the variables of this call from those of other calls.
        function: The definition of the called function.
        declared_types: The types of its variables by name, as declared.
        returns: The return statements that were reached.
    """

    call_number: int
    function: Any = None
    declared_types: dict[str, Any] = field(default_factory=dict)
    returns: list[Return] = field(default_factory=list)


Summary = Callable[..., Any]
"""Stands for a called function: takes the machine and the arguments, returns the result.

A caller then relies on what the function's contract says, and the proof does not enter its code again.
"""


class Machine:
    """A symbolic execution of one function.

    The machine keeps one memory for all paths, and the path condition: the conditions under which the program
    gets to where it is. A branch whose condition is open runs both ways, each with its condition added to the
    path condition. Where the two meet, each variable becomes a choice between its two values. So the number
    of paths does not double with every branch.

    Attributes:
        facts: What is known of the unknown numbers.
        obligations: The claims that were met on the way and must be proved.
        argument_terms: Terms of the function's arguments, by name.
        after_loop_turn: Called after each turn of an innermost loop.
    """

    def __init__(
        self,
        program: Program,
        arithmetic: type[BitVectorArithmetic | IntegerArithmetic],
        summaries: Mapping[str, Summary] | None = None,
    ) -> None:
        self.program = program
        self.arithmetic = arithmetic(self.require)
        self.summaries = summaries or {}
        self.int_type = IntegerType(program.variant.int_bits, signed=True)
        self.facts: list[Any] = []
        self.obligations: list[Obligation] = []
        self.argument_terms: dict[str, Any] = {}
        self.after_loop_turn: Callable[[Machine], None] | None = None
        self._path_condition: list[Any] = []
        self._memory: dict[tuple[int, str], Any] = {}
        # The outermost frame belongs to no function, and is never left.
        self._call_frames: list[CallFrame] = [CallFrame(0)]
        self._name_count = 0  # makes the names of the solver's variables unique

    # --- Unknown values ---

    def fresh_number(self, name: str, type_: IntegerType) -> Number:
        """Return a number of this type with any value."""
        self._name_count += 1
        number, is_in_range = self.arithmetic.fresh_number(f"{name}_{self._name_count}", type_)
        self.facts.append(is_in_range)
        return number

    def fresh_value(self, declaration: Any, name: str) -> Any:
        """Return an unknown value of a declared type: a number, or a structure of them."""
        return self._build_value(declaration, name, self.fresh_number)

    def _build_value(
        self, declaration: Any, name: str, make_number: Callable[[str, IntegerType], Number]
    ) -> Any:
        """Return a value of a declared type, whose numbers ``make_number`` makes. It is None for void."""
        type_ = self._resolve_type(declaration)
        if type_ == "void":
            return None
        if isinstance(type_, IntegerType):
            return make_number(name, type_)
        if isinstance(type_, c_ast.PtrDecl):
            return self._pointer_to_fresh_target(type_.type, name)
        if isinstance(type_, c_ast.ArrayDecl):
            length = constant_value(self.evaluate(type_.dim).term)
            return {str(index): self._build_value(type_.type, name, make_number) for index in range(length)}
        # A structure has all its members here, and a union its first one.
        members = type_.decls
        if isinstance(type_, c_ast.Union) and not self._has_separate_members(type_):
            members = type_.decls[:1]
        return {member.name: self._build_value(member.type, member.name, make_number) for member in members}

    @staticmethod
    def _has_separate_members(union: Any) -> bool:
        """Return whether the members of a union are kept apart here, as if it were a structure.

        This is so for mcp_asdf_received_t alone. A call uses its estimates or its sums, by the robot's
        filter, and never reads the one after writing the other: the contracts of receive and settle say so.
        """
        return "sums" in [member.name for member in union.decls]

    def _pointer_to_fresh_target(self, declaration: Any, name: str) -> Location:
        """Return a pointer to an unknown value. Constant words become a table of any length."""
        target_type = self._resolve_type(declaration)
        if not isinstance(target_type, IntegerType) or "const" not in declaration.quals:
            return self.new_variable(name, self.fresh_value(declaration, name))
        word_sort = self.arithmetic.constant(0, target_type).term.sort()
        # An uninterpreted function: any word for each index, and always the same one.
        word_at = z3.Function(f"{name}_{self._name_count}", word_sort, word_sort)
        return self.new_variable(name, ConstantTable(word_at, target_type)).select("0")

    def fresh_argument(self, parameter: Any) -> Any:
        """Return an unknown argument: for an array, a pointer to its first element."""
        value = self.fresh_value(parameter.type, parameter.name)
        if isinstance(parameter.type, c_ast.ArrayDecl):
            return self.new_variable(parameter.name, value).select("0")
        return value

    def constant_argument(self, parameter: Any, value: int) -> Number:
        """Return an argument with a known value."""
        return self.arithmetic.constant(value, self._resolve_type(parameter.type))

    def terms_of(self, value: Any) -> Any:
        """Return the solver's terms in a value and in what its pointers point to, by name."""
        if isinstance(value, Location):
            # A pointer to the first element stands for the array.
            points_to_array = value.path[-1:] == ("0",)
            return self.terms_of(self.load(value.enclosing_array() if points_to_array else value))
        if isinstance(value, dict):
            return {name: self.terms_of(member) for name, member in value.items()}
        return value.term if isinstance(value, Number) else value

    # --- Assumptions and claims ---

    def assume(self, formula: Any) -> None:
        """Add something that holds wherever the program gets here."""
        # Facts are global, so one that holds on this path alone has the path condition as its premise.
        path_condition = self._path_condition
        self.facts.append(z3.Implies(z3.And(path_condition), formula) if path_condition else formula)

    def require(self, formula: Any, description: str) -> None:
        """Add an obligation: the formula must hold here."""
        # What simplifies to true needs no proof.
        if not z3.is_true(z3.simplify(formula)):
            self.obligations.append(Obligation(self.assumptions_here(), formula, description))

    def assumptions_here(self) -> tuple[Any, ...]:
        """Return the facts, and the conditions under which the program gets here."""
        return (*self.facts, *self._path_condition)

    # --- Memory ---

    def new_variable(self, name: str, value: Any) -> Location:
        """Return a pointer to a new variable with this value."""
        self._name_count += 1
        location = Location((0, f"{name}_{self._name_count}"))
        self._memory[location.variable] = value
        return location

    def local_variable(self, name: str) -> Location:
        """Return the location of a variable of the function that runs."""
        return Location((self._call_frames[-1].call_number, name))

    def declare_unknown(self, declaration: Any) -> None:
        """Declare a variable that may have any value."""
        value = self.fresh_value(declaration.type, declaration.name)
        self._declare(declaration.name, declaration.type, value)

    def _declare(self, name: str, declaration: Any, value: Any) -> None:
        """Declare a variable of the function that runs, with a value converted to its type."""
        self._call_frames[-1].declared_types[name] = declaration
        location = self.local_variable(name)
        self._memory[location.variable] = self._convert(value, self._resolve_type(declaration))

    def load(self, location: Location) -> Any:
        """Return the value at a location."""
        value = self._memory[location.variable]
        for step in location.path:
            value = self._load_element(value, step)
        return value

    def _load_element(self, container: Any, step: str | Number) -> Any:
        """Return a member or element of a value."""
        if isinstance(container, ConstantTable):
            word_type = container.word_type
            index = step if isinstance(step, Number) else self.arithmetic.constant(int(step), word_type)
            word = Number(container.word_at(self._convert(index, word_type).term), word_type)
            self.facts.append(self.arithmetic.is_in_range(word))
            return word
        if isinstance(step, str):
            return container[step]
        # The index is not a constant: choose among all elements. It is claimed elsewhere to be one of them.
        first_item, *other_items = container.items()
        _, loaded_value = first_item
        for index_text, element in other_items:
            loaded_value = merge_values(self._is_index(step, index_text), element, loaded_value)
        return loaded_value

    def _is_index(self, index: Number, index_text: str) -> Any:
        """Return the formula that an index is this constant one."""
        return index.term == self.arithmetic.constant(int(index_text), index.type).term

    def store(self, location: Location, value: Any) -> Any:
        """Store a value, converted to the type of what it replaces. Return the stored value."""
        if location.path[-2:-1] == ("all",):
            return self._clear_eight_bytes(location, value)
        old_value = self.load(location)
        if isinstance(old_value, Number):
            value = self._convert(value, old_value.type)
        # Values are shared between paths, so the variable gets a new value instead of a changed one.
        variable = location.variable
        self._memory[variable] = self._replace_element(self._memory[variable], location.path, value)
        return value

    def _clear_eight_bytes(self, location: Location, value: Any) -> Any:
        """Store 0 in a long word of the union of senders heard, which has its bytes in ``of`` alone."""
        assert constant_value(value.term) == 0, "long words of a union of bytes are cleared, nothing else"
        *union_path, _all, word_index = location.path
        first_byte = 8 * int(str(word_index))
        for byte_index in range(first_byte, first_byte + 8):
            self.store(Location(location.variable, (*union_path, "of", str(byte_index))), value)
        return value

    def _replace_element(self, container: Any, path: tuple[str | Number, ...], value: Any) -> Any:
        """Return a copy of a value in which the member or element at the end of a path is another one."""
        if not path:
            return value
        step, *remaining_steps = path
        remaining_path = tuple(remaining_steps)
        if isinstance(step, str):
            return {**container, step: self._replace_element(container[step], remaining_path, value)}
        # The index is not a constant: each element becomes the new value if the index is its own.
        new_elements = {}
        for index_text, element in container.items():
            new_element = self._replace_element(element, remaining_path, value)
            new_elements[index_text] = merge_values(self._is_index(step, index_text), new_element, element)
        return new_elements

    # --- Calls ---

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function, or its summary if there is one. Return its result, or None without one."""
        if name in self.summaries:
            return self.summaries[name](self, *arguments)
        function = self.program.functions[name]
        self._name_count += 1
        frame = CallFrame(self._name_count, function)
        # When the function has returned, its own variables are out of scope.
        variables_of_callers = list(self._memory)
        self._call_frames.append(frame)
        for parameter, argument in zip(self.program.parameters(name), arguments, strict=True):
            self._declare(parameter.name, parameter.type, argument)
        path_length = len(self._path_condition)
        self.execute(function.body)
        # A return ends its path within the function, and the caller goes on after each of them.
        del self._path_condition[path_length:]
        self._call_frames.pop()
        return self._merge_returns(frame.returns, variables_of_callers)

    def _merge_returns(self, returns: list[Return], variables_of_callers: list[tuple[int, str]]) -> Any:
        """Make memory and result a choice between those of all returns. Return the result."""
        for return_ in reversed(returns):
            for variable in variables_of_callers:
                self._memory[variable] = merge_values(
                    return_.path_condition, return_.memory[variable], self._memory[variable]
                )
        if not returns:
            return None
        # On a path that reaches none of the others, the last return is the one.
        result = returns[-1].result
        for return_ in reversed(returns[:-1]):
            result = merge_values(return_.path_condition, return_.result, result)
        return result

    # --- Statements ---

    def execute(self, node: Any) -> None:
        """Execute a statement. Each kind has a method, ``_execute_if`` for c_ast.If."""
        method_name = f"_execute_{type(node).__name__.lower()}"
        getattr(self, method_name, self.evaluate)(node)

    def _execute_compound(self, node: Any) -> None:
        for statement in node.block_items or []:
            self.execute(statement)

    def _execute_decllist(self, node: Any) -> None:
        for declaration in node.decls:
            self.execute(declaration)

    def _execute_decl(self, node: Any) -> None:
        """Declare a variable. Without an initial value an array is unknown, and others have no value."""
        initial_value = None
        if isinstance(node.init, c_ast.InitList):
            initial_value = self._evaluate_initializer(self._resolve_type(node.type), node.init)
        elif node.init is not None:
            initial_value = self.evaluate(node.init)
        elif isinstance(node.type, c_ast.ArrayDecl):
            # Elements are stored one by one, into an array that must exist and may hold anything.
            initial_value = self.fresh_value(node.type, node.name)
        self._declare(node.name, node.type, initial_value)

    def _execute_return(self, node: Any) -> None:
        """Record the result and the memory of this path for the caller, and end the path."""
        frame = self._call_frames[-1]
        result = None if node.expr is None else self.evaluate(node.expr)
        result = self._convert(result, self._resolve_type(frame.function.decl.type.type))
        frame.returns.append(Return(z3.And(self._path_condition), result, dict(self._memory)))
        # Nothing behind a return is reached on this path, so anything may be claimed there.
        self._path_condition.append(z3.BoolVal(False))

    def _execute_if(self, node: Any) -> None:
        def execute_else() -> None:
            if node.iffalse is not None:
                self.execute(node.iffalse)

        condition = self.evaluate_condition(node.cond)
        self._execute_branches(condition, lambda: self.execute(node.iftrue), execute_else)

    def _execute_for(self, node: Any) -> None:
        if node.init is not None:
            self.execute(node.init)
        self._execute_turns(node, 0)

    def _execute_while(self, node: Any) -> None:
        self._execute_turns(node, 0)

    def _execute_emptystatement(self, node: Any) -> None:
        """Do nothing."""

    def _execute_turns(self, loop: Any, turns_before: int) -> None:
        """Execute what remains of a loop after some turns.

        The loop is unrolled: a turn is a branch within the turn before. It ends when the condition simplifies
        to false. After the documented number of turns it must be false, which becomes an obligation.
        """
        condition = z3.simplify(self.evaluate_condition(loop.cond))
        max_turns = documented_max_turns(loop)
        if z3.is_false(condition):
            return
        if turns_before == max_turns:
            description = f"at most {max_turns} turns of the loop in line {loop.coord.line}"
            self.require(z3.Not(condition), description)
            return

        def execute_next_turn() -> None:
            self.execute(loop.stmt)
            # An invariant replaces what is known after the turn, before the counter moves.
            if self.after_loop_turn is not None and not any(nodes(loop.stmt, c_ast.For)):
                self.after_loop_turn(self)
            if isinstance(loop, c_ast.For):
                self.evaluate(loop.next)
            self._execute_turns(loop, turns_before + 1)

        self._execute_branches(condition, execute_next_turn, lambda: None)

    def _execute_branches(
        self, condition: Any, execute_then: Callable[[], None], execute_else: Callable[[], None]
    ) -> None:
        """Execute one branch if the condition is a constant, else both, and merge the two memories."""
        condition = z3.simplify(condition)
        if z3.is_true(condition):
            execute_then()
            return
        if z3.is_false(condition):
            execute_else()
            return
        # The condition is open, so both branches begin with the same memory.
        memory_before = dict(self._memory)
        with self._path_under(condition) as assumptions_after_then:
            execute_then()
        memory_after_then, self._memory = self._memory, memory_before
        with self._path_under(z3.Not(condition)) as assumptions_after_else:
            execute_else()
        # The join: a variable becomes a choice between what the two branches left in it. Variables that only
        # one branch has declared are out of scope.
        self._memory = {
            variable: merge_values(condition, memory_after_then[variable], value)
            for variable, value in self._memory.items()
            if variable in memory_after_then
        }
        self._path_condition += assumptions_after_then + assumptions_after_else

    @contextmanager
    def _path_under(self, condition: Any) -> Iterator[list[Any]]:
        """Execute the block under a path condition that is longer by this condition.

        Yields an empty list. When the block ends, the list has the formulas that then hold on all paths: if
        the condition was true, no return has ended the path within the block.
        """
        path_length = len(self._path_condition)
        assumptions_afterwards = list[Any]()
        self._path_condition.append(condition)
        yield assumptions_afterwards
        conditions_of_block = self._path_condition[path_length + 1 :]
        assumptions_afterwards += [z3.Implies(condition, added) for added in conditions_of_block]
        del self._path_condition[path_length:]

    @contextmanager
    def _effects_only_if(self, condition: Any) -> Iterator[None]:
        """Evaluate a part of an expression in the block: it changes memory only where the condition holds."""
        memory_before = dict(self._memory)
        with self._path_under(condition):
            yield
        for variable, old_value in memory_before.items():
            self._memory[variable] = merge_values(condition, self._memory[variable], old_value)

    # --- Expressions ---

    def evaluate(self, node: Any) -> Any:
        """Return the value of an expression. Each kind has a method, ``_evaluate_cast`` for c_ast.Cast."""
        method_name = f"_evaluate_{type(node).__name__.lower()}"
        return getattr(self, method_name)(node)

    def evaluate_condition(self, node: Any) -> Any:
        """Return the formula that an expression is not 0."""
        if isinstance(node, c_ast.BinaryOp) and node.op in ("&&", "||"):
            left_condition = self.evaluate_condition(node.left)
            # The right operand is only evaluated if the left one does not settle the result.
            needs_right = left_condition if node.op == "&&" else z3.Not(left_condition)
            with self._effects_only_if(needs_right):
                right_condition = self.evaluate_condition(node.right)
            combine = z3.And if node.op == "&&" else z3.Or
            return combine(left_condition, right_condition)
        if isinstance(node, c_ast.UnaryOp) and node.op == "!":
            return z3.Not(self.evaluate_condition(node.expr))
        if isinstance(node, c_ast.BinaryOp) and node.op in _COMPARISON_SYMBOLS:
            left_operand, right_operand = self.evaluate(node.left), self.evaluate(node.right)
            return self.arithmetic.compare(node.op, *self._to_common_type(left_operand, right_operand))
        return self.evaluate(node).term != 0

    def _evaluate_constant(self, node: Any) -> Number:
        """Return a literal number, whose type is the first of C's list that holds its value."""
        digits = node.value.rstrip("uUlL")
        value = int(digits, 0)
        is_unsigned_only = "u" in node.value.lower()
        may_be_unsigned = is_unsigned_only or digits.startswith("0x")
        # int, long and long long, each signed first; decimal literals without a U are never unsigned.
        for bits in (self.int_type.bits, 32, 64):
            for signed in (True, False):
                is_allowed = not is_unsigned_only if signed else may_be_unsigned
                type_ = IntegerType(bits, signed)
                if is_allowed and value <= type_.maximum:
                    return self.arithmetic.constant(value, type_)
        raise NotImplementedError(node.value)

    def _evaluate_id(self, node: Any) -> Any:
        """Return the value of an enumeration's constant or of a variable."""
        enumeration_value = self.program.constants.get(node.name)
        if enumeration_value is not None:
            return self.evaluate(enumeration_value)
        return self.load(self.local_variable(node.name))

    def _evaluate_structref(self, node: Any) -> Any:
        """Return a member of a structure, or of one that a pointer points to."""
        structure = self.evaluate(node.name)
        if node.type == "->":
            structure = self.load(structure)
        return structure[node.field.name]

    def _evaluate_arrayref(self, node: Any) -> Any:
        """Return an element of an array, or of one that a pointer points into."""
        array = self.evaluate(node.name)
        index = z3.simplify(self.evaluate(node.subscript).term)
        # An array that is a value is a dictionary, of which a constant index needs no location.
        if isinstance(array, Location) or not is_constant(index):
            return self.load(self._locate(node))
        return array[str(index.as_long())]

    def _evaluate_cast(self, node: Any) -> Any:
        """Return a value converted to another type; the only other one than an integer type is float."""
        type_ = self._resolve_type(node.to_type.type)
        value = self.evaluate(node.expr)
        return round_to_binary32(value) if type_ == "float" else self._convert(value, type_)

    def _evaluate_ternaryop(self, node: Any) -> Any:
        condition = z3.simplify(self.evaluate_condition(node.cond))
        if z3.is_true(condition):
            return self.evaluate(node.iftrue)
        if z3.is_false(condition):
            return self.evaluate(node.iffalse)
        # C evaluates one of the two, so each may change memory on its own path alone.
        with self._effects_only_if(condition):
            value_if_true = self.evaluate(node.iftrue)
        with self._effects_only_if(z3.Not(condition)):
            value_if_false = self.evaluate(node.iffalse)
        if isinstance(value_if_true, Number):
            value_if_true, value_if_false = self._to_common_type(value_if_true, value_if_false)
        return merge_values(condition, value_if_true, value_if_false)

    def _evaluate_unaryop(self, node: Any) -> Any:
        if node.op == "&":
            return self._locate(node.expr)
        if node.op == "*":
            return self.load(self.evaluate(node.expr))
        if node.op in ("++", "--", "p++", "p--"):
            old_value = self.evaluate(node.expr)
            new_value = self._update(node.expr, node.op[-1], self.arithmetic.constant(1, self.int_type))
            return old_value if node.op.startswith("p") else new_value  # p: the operator stands behind
        if node.op == "!":
            return self._to_int(self.evaluate_condition(node))
        number = self._promote(self.evaluate(node.expr))
        # -x is 0 - x, and ~x is x with all bits of -1 flipped.
        symbol, left_value = {"-": ("-", 0), "~": ("^", -1)}[node.op]
        return self.arithmetic.binary(symbol, self.arithmetic.constant(left_value, number.type), number)

    def _evaluate_binaryop(self, node: Any) -> Number:
        if node.op in ("&&", "||", *_COMPARISON_SYMBOLS):
            return self._to_int(self.evaluate_condition(node))
        left_operand, right_operand = self.evaluate(node.left), self.evaluate(node.right)
        self._require_documented_shift(node, node.op, right_operand)
        return self._apply_operator(node.op, left_operand, right_operand)

    def _evaluate_assignment(self, node: Any) -> Any:
        if node.op == "=":
            value = self.evaluate(node.rvalue)
            return self.store(self._locate(node.lvalue), value)
        symbol = node.op.removesuffix("=")
        right_operand = self.evaluate(node.rvalue)
        self._require_documented_shift(node, symbol, right_operand)
        return self._update(node.lvalue, symbol, right_operand)

    def _evaluate_funccall(self, node: Any) -> Any:
        """Call a function with its arguments converted to the types of its parameters."""
        arguments = [self._evaluate_argument(argument) for argument in node.args.exprs]
        name = node.name.name
        if name == "__builtin_clz":
            return self._count_leading_zeros(arguments[0])
        types = [self._resolve_type(parameter.type) for parameter in self.program.parameters(name)]
        return self.call(name, *map(self._convert, arguments, types))

    def _evaluate_argument(self, node: Any) -> Any:
        """Return the value of an argument: for a local array, a pointer to its first element."""
        if isinstance(node, c_ast.ID):
            declaration = self._call_frames[-1].declared_types.get(node.name)
            location = self.local_variable(node.name)
            if isinstance(declaration, c_ast.ArrayDecl) and isinstance(self.load(location), dict):
                return location.select("0")
        return self.evaluate(node)

    def _count_leading_zeros(self, number: Number) -> Number:
        """Return what __builtin_clz() of gcc and clang does. It is undefined for 0."""
        self.require(number.term != 0, "leading zeros of 0")
        count = self.arithmetic.constant(31, self.int_type).term
        for bit in range(32):  # from the lowest, so that the highest bit that is set decides
            count_if_set = self.arithmetic.constant(31 - bit, self.int_type).term
            count = z3.If(z3.Extract(bit, bit, number.term) == 1, count_if_set, count)
        return Number(count, self.int_type)

    # --- Locations of expressions ---

    def _locate(self, node: Any) -> Location:
        """Return the location that an expression names; one that names none is an error."""
        if isinstance(node, c_ast.ID):
            return self.local_variable(node.name)
        if isinstance(node, c_ast.StructRef):
            structure = self._locate(node.name) if node.type == "." else self.evaluate(node.name)
            assert isinstance(structure, Location)
            return structure.select(node.field.name)
        if isinstance(node, c_ast.ArrayRef):
            return self._locate_element(node)
        if isinstance(node, c_ast.UnaryOp) and node.op == "*":
            # The value of a pointer is the location that it points to.
            target = self.evaluate(node.expr)
            assert isinstance(target, Location)
            return target
        raise NotImplementedError(f"{type(node).__name__} as a place")

    def _locate_element(self, node: Any) -> Location:
        """Return the location of an element: of an array, or counted from where a pointer points to."""
        index = self.evaluate(node.subscript)
        if isinstance(node.name, c_ast.StructRef) and node.name.field.name == "all":
            return self._locate(node.name).select(str(constant_value(index.term)))
        array = self.evaluate(node.name)
        if isinstance(array, dict):
            array_location, start_index = self._locate(node.name), 0
        else:
            # A pointer into an array ends with the index of the element that it points to.
            array_location, start_index = array.enclosing_array(), int(array.path[-1])
        simplified_index = z3.simplify(index.term)
        if is_constant(simplified_index):
            return array_location.select(str(start_index + simplified_index.as_long()))
        assert start_index == 0, "a pointer into an array, and an unknown distance"
        elements = self.load(array_location)
        if isinstance(elements, dict):
            zero, length = (self.arithmetic.constant(bound, index.type) for bound in (0, len(elements)))
            is_at_least_0 = self.arithmetic.compare(">=", index, zero)
            is_below_length = self.arithmetic.compare("<", index, length)
            self.require(z3.And(is_at_least_0, is_below_length), "an element of the array")
        return array_location.select(index)

    # --- Operators and types ---

    def _update(self, target: Any, symbol: str, right_operand: Number) -> Any:
        """Execute ``target symbol= right``, and return the new value."""
        location = self._locate(target)
        return self.store(location, self._apply_operator(symbol, self.load(location), right_operand))

    def _apply_operator(self, symbol: str, left_operand: Number, right_operand: Number) -> Number:
        """Return the result of an arithmetic operator, after C's usual conversions."""
        if symbol in ("<<", ">>"):  # the count does not change the type of the result
            return self.arithmetic.binary(symbol, self._promote(left_operand), self._promote(right_operand))
        return self.arithmetic.binary(symbol, *self._to_common_type(left_operand, right_operand))

    def _require_documented_shift(self, node: Any, symbol: str, count: Number) -> None:
        """Require that a shift's count is at most the bound in the comment beside it."""
        max_shift = documented_max_shift(node) if symbol in ("<<", ">>") else None
        if max_shift is not None:
            limit = self.arithmetic.constant(max_shift, count.type)
            self.require(self.arithmetic.compare("<=", count, limit), f"a shift by at most {max_shift}")

    def _promote(self, number: Number) -> Number:
        """Return a number as an int, if its type is shorter."""
        if number.type.bits >= self.int_type.bits:
            return number
        return self.arithmetic.convert(number, self.int_type)

    def _to_common_type(self, left_operand: Number, right_operand: Number) -> tuple[Number, Number]:
        """Return two numbers as ones of the type in which C computes: the longer one, or the unsigned one."""
        left_operand, right_operand = self._promote(left_operand), self._promote(right_operand)
        bits = max(left_operand.type.bits, right_operand.type.bits)
        # A longer signed type can hold all values of a shorter unsigned one.
        longest_types = [number.type for number in (left_operand, right_operand) if number.type.bits == bits]
        common_type = IntegerType(bits, signed=all(type_.signed for type_ in longest_types))
        return self._convert(left_operand, common_type), self._convert(right_operand, common_type)

    def _convert(self, value: Any, type_: Any) -> Any:
        """Return a number as one of an integer type, and anything else unchanged."""
        if not isinstance(type_, IntegerType) or not isinstance(value, Number) or value.type == type_:
            return value
        return self.arithmetic.convert(value, type_)

    def _to_int(self, condition: Any) -> Number:
        """Return 1 where a condition holds, and 0 elsewhere."""
        true_term, false_term = (self.arithmetic.constant(value, self.int_type).term for value in (1, 0))
        return Number(z3.If(condition, true_term, false_term), self.int_type)

    def _evaluate_initializer(self, type_: Any, node: Any) -> Any:
        """Return the value of a structure or union that is declared with a list of values."""
        if isinstance(type_, c_ast.Union):
            return self._evaluate_union_initializer(node)
        member_types = {member.name: self._resolve_type(member.type) for member in type_.decls}
        # Members that the list leaves out are 0.
        members = self._build_value(
            type_, "", lambda _, number_type: self.arithmetic.constant(0, number_type)
        )
        for (name, member_type), expression in zip(member_types.items(), node.exprs, strict=False):
            if isinstance(member_type, (IntegerType, c_ast.PtrDecl)):
                members[name] = self._convert(self.evaluate(expression), member_type)
        return members

    def _evaluate_union_initializer(self, node: Any) -> dict[str, Any]:
        """Return the member that a union is read by: one list initialises one, and the other one is read.

        The headers have two unions: a binary32 and its bits; a long word and its two halves on an AVR.
        """
        (initializer,) = node.exprs
        if isinstance(initializer, c_ast.Cast):
            return {"bits": Number(z3.fpToIEEEBV(self.evaluate(initializer)), INTEGER_TYPES["int32_t"])}
        long_type, half_bits = INTEGER_TYPES["uint64_t"], self.arithmetic.constant(32, self.int_type)
        if initializer.name[0].name == "both":
            both = self.evaluate(initializer.expr)
            halves = (both, self.arithmetic.binary(">>", both, half_bits))
            low, high = (self._convert(half, INTEGER_TYPES["uint32_t"]) for half in halves)
            return {"word": {"0": low, "1": high}}
        low, high = (self._convert(self.evaluate(half), long_type) for half in initializer.expr.exprs)
        return {"both": self.arithmetic.binary("+", self.arithmetic.binary("<<", high, half_bits), low)}

    def _resolve_type(self, declaration: Any) -> Any:
        """Return the integer type, structure, union, array or pointer that is declared.

        Any other type is returned by its name, such as "void" or "float".
        """
        if isinstance(declaration, c_ast.TypeDecl):
            return self._resolve_type(declaration.type)
        if isinstance(declaration, c_ast.IdentifierType):
            name = declaration.names[-1]
            if name == "int":
                return self.int_type
            if name in INTEGER_TYPES:
                return INTEGER_TYPES[name]
            return self._resolve_type(self.program.types[name]) if name in self.program.types else name
        return self.int_type if isinstance(declaration, c_ast.Enum) else declaration


def round_to_binary32(number: Number) -> Any:
    """Return a signed word rounded to binary32, to nearest."""
    return z3.fpSignedToFP(z3.RNE(), number.term, z3.Float32())


def merge_values(condition: Any, value_if_true: Any, value_if_false: Any) -> Any:
    """Return a value of memory that is the first one where the condition holds, and the second elsewhere.

    A value that does not exist on one of the two paths is the one of the other path.
    """
    if value_if_true is value_if_false or value_if_false is None:
        return value_if_true
    if value_if_true is None:
        return value_if_false
    if isinstance(value_if_true, Number):
        if value_if_true.term.eq(value_if_false.term):
            return value_if_true
        return Number(z3.If(condition, value_if_true.term, value_if_false.term), value_if_true.type)
    if isinstance(value_if_true, dict):
        return {
            name: merge_values(condition, member, value_if_false[name])
            for name, member in value_if_true.items()
        }
    assert value_if_true == value_if_false, "a pointer that depends on a condition"
    return value_if_true


def choose_terms(condition: Any, terms_if_true: Any, terms_if_false: Any) -> Any:
    """Return, in a formula, the first terms where the condition holds, and the second elsewhere."""
    if isinstance(terms_if_true, dict):
        return {
            name: choose_terms(condition, member, terms_if_false[name])
            for name, member in terms_if_true.items()
        }
    if isinstance(terms_if_true, ConstantTable):
        return ConstantTable(
            lambda index: z3.If(condition, terms_if_true.word_at(index), terms_if_false.word_at(index)),
            terms_if_true.word_type,
        )
    return z3.If(condition, terms_if_true, terms_if_false)
