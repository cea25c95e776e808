"""Symbolic execution: run a function of the firmware on unknown numbers, on one path after the other.

A value is a term of the solver instead of a number. The machine knows the small part of C that the firmware
uses; anything else raises an error. A value in memory is one of these:

- a ``Number``
- a ``Pointer``
- a ``ConstantTable``
- a dictionary for a structure or an array: values by the names of members, or by the indices of elements
- a ``Union``
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import z3
from pycparser import c_ast

from proofs.numbers import IntegerType, Number, apply_operator, compare, constant, constant_value, convert
from proofs.solver import prove
from proofs.source import Program, documented_max_shift, documented_max_turns, nodes, variables_changed_by

_COMPARISON_SYMBOLS = ("<", "<=", ">", ">=", "==", "!=")
_BINARY_FORMS = {"-": ("-", 0), "~": ("^", -1)}
"""Unary operators as binary ones with a left operand: -x is 0 - x, and ~x flips all bits of -1 that x has."""
INTEGER_TYPES = {
    "_Bool": IntegerType(1),
    **{f"uint{bits}_t": IntegerType(bits) for bits in (8, 16, 32, 64)},
    **{f"int{bits}_t": IntegerType(bits, signed=True) for bits in (8, 16, 32, 64)},
}


@dataclass(frozen=True)
class ConstantTable:
    """An array of constant words, any number of them.

    Attributes:
        word_at: Takes the term of an index, and returns the term of the word there.
        word_type: The type of each word, and of indices.
    """

    word_at: Any
    word_type: IntegerType


@dataclass(frozen=True, eq=False)
class Pointer:
    """A pointer to a value in memory.

    Attributes:
        container: What has the value: a structure, an array, a table, or the variables of a function.
        key: Name of the member or variable, or index of the element: a number if it is not a constant.
    """

    container: Any
    key: str | int | Number


class Union(dict[str, Any]):
    """A union, as a dictionary with one entry: the member that was written or read last.

    Attributes:
        declarations: All members, by name.
    """

    def __init__(self, declarations: Mapping[str, Any], name: str, value: Any) -> None:
        super().__init__({name: value})
        self.declarations = declarations

    def bits(self) -> Any:
        """Return the bits of the union as one long word. The lowest ones stand first in memory."""
        words = [_bits_of(value) for value in _leaves_of(self)]
        return z3.Concat(*reversed(words)) if len(words) > 1 else words[0]


class Return(Exception):  # noqa: N818 - it is no error
    """Ends the function that runs, with its result."""


class PathEndsError(Exception):
    """Ends the path: what follows is executed on another one."""


Summary = Callable[..., Any]
"""Stands for a called function: takes the machine and the arguments, returns the result.

A caller then relies on what the function's contract says, and the proof does not enter its code again.
"""


class Machine:
    """A symbolic execution of one function on one path.

    Where a condition is open the path forks: the machine takes the condition for true, and ``other_paths``
    gets the decisions that lead to the other side. ``all_paths`` goes there in turn. What the code relies on
    is proved where it is met.

    Attributes:
        facts: What is known of the unknown numbers, and the conditions under which the program gets here.
        loop_invariant: What holds after each turn of an innermost loop, or None. It takes the terms of the
            function's variables by name, and returns a formula.
        decisions: What was decided at each fork so far, or will be.
        other_paths: Decisions of the paths that leave this one.
    """

    def __init__(
        self,
        program: Program,
        summaries: Mapping[str, Summary] | None = None,
        decisions: tuple[bool, ...] = (),
    ) -> None:
        self.program = program
        self.summaries = summaries or {}
        self.int_type = IntegerType(program.variant.int_bits, signed=True)
        self.facts: list[Any] = []
        self.loop_invariant: Callable[[dict[str, Any]], Any] | None = None
        self.decisions = list(decisions)
        self.other_paths: list[tuple[bool, ...]] = []
        self._forks_passed = 0
        self._name_count = 0  # makes the names of the solver's variables unique
        # Variables of the function that runs, by name, and its definition. No function runs at first.
        self.variables: dict[str, Any] = {}
        self._function: Any = None

    # --- Unknown values ---

    def fresh_number(self, name: str, type_: IntegerType) -> Number:
        """Return a number of this type with any value."""
        self._name_count += 1
        return Number(z3.BitVec(f"{name}_{self._name_count}", type_.bits), type_)

    def fresh_value(self, declaration: Any, name: str) -> Any:
        """Return an unknown value of a declared type: a number, or a structure of them."""
        return self._build_value(declaration, name, self.fresh_number)

    def _build_value(
        self, declaration: Any, name: str, make_number: Callable[[str, IntegerType], Number]
    ) -> Any:
        """Return a value of a declared type, or None for void. ``make_number`` makes the numbers in it."""
        type_ = self._resolve_type(declaration)
        if type_ == "void":
            return None
        if isinstance(type_, IntegerType):
            return make_number(name, type_)
        if isinstance(type_, c_ast.PtrDecl):
            return self._pointer_to_fresh_target(type_.type, name)
        if isinstance(type_, c_ast.ArrayDecl):
            length = constant_value(self.evaluate(type_.dim).term)
            assert length is not None
            return {index: self._build_value(type_.type, name, make_number) for index in range(length)}
        declarations = {member.name: member.type for member in type_.decls}
        # The round's estimates and sums share memory, too. But by the robot's filter a call uses one of them,
        # and never reads the one after writing the other: the contracts of receive and settle say so. So the
        # machine has both, as if they were members of a structure.
        if isinstance(type_, c_ast.Union) and "sums" not in declarations:
            first_name, first_type = next(iter(declarations.items()))
            return Union(declarations, first_name, self._build_value(first_type, first_name, make_number))
        return {
            member_name: self._build_value(member_type, member_name, make_number)
            for member_name, member_type in declarations.items()
        }

    def _pointer_to_fresh_target(self, declaration: Any, name: str) -> Pointer:
        """Return a pointer to an unknown value. Constant words become a table of any length."""
        target_type = self._resolve_type(declaration)
        if not isinstance(target_type, IntegerType) or "const" not in declaration.quals:
            return Pointer({name: self.fresh_value(declaration, name)}, name)
        word_sort = z3.BitVecSort(target_type.bits)
        # An uninterpreted function: any word for each index, and always the same one.
        return Pointer(ConstantTable(z3.Function(f"{name} words", word_sort, word_sort), target_type), 0)

    def fresh_argument(self, parameter: Any) -> Any:
        """Return an unknown argument. If the parameter is an array, it is a pointer to the first element."""
        value = self.fresh_value(parameter.type, parameter.name)
        return Pointer(value, 0) if isinstance(parameter.type, c_ast.ArrayDecl) else value

    # --- Paths, assumptions and claims ---

    def holds(self, condition: Any) -> bool:
        """Return whether a condition holds on this path; where both is possible, the path forks here."""
        condition = z3.simplify(condition)
        opposite = z3.simplify(z3.Not(condition))
        if z3.is_true(condition) or any(condition.eq(fact) for fact in self.facts):
            return True
        if z3.is_true(opposite) or any(opposite.eq(fact) for fact in self.facts):
            return False
        if self._forks_passed == len(self.decisions):
            self.other_paths.append((*self.decisions, False))
            self.decisions.append(True)
        decision = self.decisions[self._forks_passed]
        self._forks_passed += 1
        self.facts.append(condition if decision else opposite)
        return decision

    def require(self, formula: Any, description: str) -> None:
        """Prove that a formula holds here. Raises UnprovenError, with the description, if it might not."""
        # Up to its last known decision, this path is the same as an earlier one, which had the same proofs.
        is_repetition = self._forks_passed < len(self.decisions)
        # What simplifies to true needs no proof.
        if not is_repetition and not z3.is_true(z3.simplify(formula)):
            prove(formula, *self.facts, description=description)

    @contextmanager
    def _supposing(self, condition: Any) -> Iterator[None]:
        """Evaluate, in the block, an expression that is only evaluated where the condition holds."""
        position = len(self.facts)
        self.facts.append(condition)
        yield
        del self.facts[position]

    # --- Memory ---

    def load(self, pointer: Pointer) -> Any:
        """Return the value that a pointer points to."""
        container, key = pointer.container, pointer.key
        if isinstance(container, ConstantTable):
            index = key if isinstance(key, Number) else constant(int(key), container.word_type)
            return Number(container.word_at(convert(index, container.word_type).term), container.word_type)
        if not isinstance(key, Number):
            return container[key]
        # The index is not a constant: choose among all elements. That it is one of them was proved before.
        _, loaded = next(iter(container.items()))
        for index, element in container.items():
            loaded = Number(z3.If(key.term == index, element.term, loaded.term), element.type)
        return loaded

    def store(self, pointer: Pointer, value: Any) -> Any:
        """Store a value, converted to the type of what it replaces. Return the stored value."""
        container, key = pointer.container, pointer.key
        old_value = self.load(pointer)
        value = copy_value(convert(value, old_value.type) if isinstance(old_value, Number) else value)
        if isinstance(key, Number):
            # The index is not a constant: each element becomes the new value if the index is its own.
            for index, element in container.items():
                container[index] = Number(z3.If(key.term == index, value.term, element.term), element.type)
        else:
            container[key] = value
        return value

    def declare(self, name: str, declaration: Any, value: Any) -> None:
        """Declare a variable of the function that runs, with a value converted to its type."""
        self.variables[name] = copy_value(self._convert(value, self._resolve_type(declaration)))

    # --- Calls ---

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function, or its summary if there is one. Return its result, or None without one."""
        if name in self.summaries:
            return self.summaries[name](self, *arguments)
        caller = self._function, self.variables
        self._function, self.variables = self.program.functions[name], {}
        for parameter, argument in zip(self.program.parameters(name), arguments, strict=True):
            self.declare(parameter.name, parameter.type, argument)
        result = None
        try:
            self.evaluate(self._function.body)
        except Return as return_:
            (result,) = return_.args
        self._function, self.variables = caller
        return result

    # --- Statements ---

    def evaluate(self, node: Any) -> Any:
        """Execute a statement, or return the value of an expression.

        Each kind of node has a method, ``_evaluate_cast`` for c_ast.Cast. Another kind is an error. An error
        gets a note with the node that raised it and its place in the C.
        """
        kind = type(node).__name__
        try:
            method = getattr(self, f"_evaluate_{kind.lower()}", None)
            if method is None:
                raise NotImplementedError(f"the machine does not know {kind}")
            return method(node)
        except (Return, PathEndsError):
            raise
        except Exception as error:
            # The innermost node that has a place is the first one here.
            if node.coord is not None and not hasattr(error, "__notes__"):
                error.add_note(f"{kind} at {node.coord}")
            raise

    def _evaluate_compound(self, node: Any) -> None:
        for statement in node.block_items or []:
            self.evaluate(statement)

    def _evaluate_decllist(self, node: Any) -> None:
        for declaration in node.decls:
            self.evaluate(declaration)

    def _evaluate_decl(self, node: Any) -> None:
        """Declare a variable, which may have any value if the program gives it none."""
        if node.init is not None:
            initial_value = self._evaluate_initializer(node.type, node.init)
        else:
            initial_value = self.fresh_value(node.type, node.name)
        self.declare(node.name, node.type, initial_value)

    def _evaluate_return(self, node: Any) -> None:
        result = None if node.expr is None else self.evaluate(node.expr)
        raise Return(self._convert(result, self._resolve_type(self._function.decl.type.type)))

    def _evaluate_if(self, node: Any) -> None:
        if self.holds(self.evaluate_condition(node.cond)):
            self.evaluate(node.iftrue)
        elif node.iffalse is not None:
            self.evaluate(node.iffalse)

    def _evaluate_for(self, node: Any) -> None:
        if node.init is not None:
            self.evaluate(node.init)
        self._evaluate_while(node)

    def _evaluate_while(self, node: Any) -> None:
        """Execute the turns of a loop: after the documented number its condition must be false."""
        max_turns = documented_max_turns(node)
        for _turn in range(max_turns):
            if not self.holds(self.evaluate_condition(node.cond)):
                return
            forks_before = self._forks_passed
            self.evaluate(node.stmt)
            if self.loop_invariant is not None and not any(nodes(node.stmt, c_ast.For)):
                self._forget_turn(node.stmt, forks_before)
            if isinstance(node, c_ast.For):
                self.evaluate(node.next)
        description = f"at most {max_turns} turns of the loop in line {node.coord.line}"
        self.require(z3.Not(self.evaluate_condition(node.cond)), description)

    def _forget_turn(self, body: Any, forks_before: int) -> None:
        """Claim the invariant, and let the code after a turn rely on nothing else that the turn did.

        The variables that the loop's body changes may then hold anything that fulfils the invariant. So the
        formulas stay as short as for one turn. As the rest is the same on all paths through the turn, one of
        them goes on, and the others end here.
        """
        for kind in (c_ast.ArrayRef, c_ast.StructRef, c_ast.FuncCall):
            assert not any(nodes(body, kind)), "a turn that may change more than variables"
        assert not any(unary.op == "*" for unary in nodes(body, c_ast.UnaryOp)), "a turn that uses a pointer"
        assert self.loop_invariant is not None
        self.require(self.loop_invariant(terms_of(self.variables)), "the invariant of a loop")
        if False in self.decisions[forks_before : self._forks_passed]:
            raise PathEndsError
        for name in variables_changed_by(body):
            self.variables[name] = self.fresh_number(name, self.variables[name].type)
        # The first fact is what the function requires.
        self.facts[1:] = [self.loop_invariant(terms_of(self.variables))]

    def _evaluate_emptystatement(self, node: Any) -> None:
        """Do nothing."""

    # --- Expressions ---

    def evaluate_condition(self, node: Any) -> Any:
        """Return the formula that an expression is not 0."""
        if isinstance(node, c_ast.BinaryOp) and node.op in ("&&", "||"):
            return self._evaluate_logical(node)
        if isinstance(node, c_ast.UnaryOp) and node.op == "!":
            return z3.Not(self.evaluate_condition(node.expr))
        if isinstance(node, c_ast.BinaryOp) and node.op in _COMPARISON_SYMBOLS:
            left_operand, right_operand = self.evaluate(node.left), self.evaluate(node.right)
            return compare(node.op, *self._to_common_type(left_operand, right_operand))
        return self.evaluate(node).term != 0

    def _evaluate_logical(self, node: Any) -> Any:
        """Return the formula of an && or ||. Where the left operand does not decide, the right one does."""
        is_left_true = self.holds(self.evaluate_condition(node.left))
        is_settled = is_left_true == (node.op == "||")
        return z3.BoolVal(is_left_true) if is_settled else self.evaluate_condition(node.right)

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
                    return constant(value, type_)
        raise NotImplementedError(f"the machine has no integer type for {node.value}")

    def _evaluate_id(self, node: Any) -> Any:
        """Return the value of an enumeration's constant or of a variable."""
        enumeration_value = self.program.constants.get(node.name)
        if enumeration_value is not None:
            return self.evaluate(enumeration_value)
        return self.variables[node.name]

    def _evaluate_structref(self, node: Any) -> Any:
        return self.load(self._locate(node))

    def _evaluate_arrayref(self, node: Any) -> Any:
        return self.load(self._locate(node))

    def _evaluate_cast(self, node: Any) -> Any:
        """Return a value converted to another type; the only other one than an integer type is float."""
        type_ = self._resolve_type(node.to_type.type)
        value = self.evaluate(node.expr)
        if type_ == "float":
            return z3.fpSignedToFP(z3.RNE(), value.term, z3.Float32())  # to nearest
        return self._convert(value, type_)

    def _evaluate_ternaryop(self, node: Any) -> Any:
        condition = z3.simplify(self.evaluate_condition(node.cond))
        is_constant = z3.is_true(condition) or z3.is_false(condition)
        if is_constant or _has_effects(node.iftrue) or _has_effects(node.iffalse):
            return self.evaluate(node.iftrue if self.holds(condition) else node.iffalse)
        # Without effects the two values become one term, and the path need not fork.
        with self._supposing(condition):
            value_if_true = self.evaluate(node.iftrue)
        with self._supposing(z3.Not(condition)):
            value_if_false = self.evaluate(node.iffalse)
        value_if_true, value_if_false = self._to_common_type(value_if_true, value_if_false)
        return Number(z3.If(condition, value_if_true.term, value_if_false.term), value_if_true.type)

    def _evaluate_unaryop(self, node: Any) -> Any:
        if node.op == "&":
            return self._locate(node.expr)
        if node.op == "*":
            return self.load(self.evaluate(node.expr))
        if node.op in ("++", "--", "p++", "p--"):
            old_value = self.evaluate(node.expr)
            new_value = self._update(node.expr, node.op[-1], constant(1, self.int_type))
            return old_value if node.op.startswith("p") else new_value  # p: the operator stands behind
        if node.op == "!":
            return self._to_int(self.evaluate_condition(node))
        if node.op not in _BINARY_FORMS:
            raise NotImplementedError(f"the machine does not know the operator {node.op}")
        number = self._promote(self.evaluate(node.expr))
        symbol, left_value = _BINARY_FORMS[node.op]
        return apply_operator(symbol, constant(left_value, number.type), number, self.require)

    def _evaluate_binaryop(self, node: Any) -> Number:
        if node.op in ("&&", "||", *_COMPARISON_SYMBOLS):
            return self._to_int(self.evaluate_condition(node))
        left_operand, right_operand = self.evaluate(node.left), self.evaluate(node.right)
        self._require_documented_shift(node, node.op, right_operand)
        return self._apply_operator(node.op, left_operand, right_operand)

    def _evaluate_assignment(self, node: Any) -> Any:
        right_operand = self.evaluate(node.rvalue)
        if node.op == "=":
            return self.store(self._locate(node.lvalue), right_operand)
        symbol = node.op.removesuffix("=")
        self._require_documented_shift(node, symbol, right_operand)
        return self._update(node.lvalue, symbol, right_operand)

    def _evaluate_funccall(self, node: Any) -> Any:
        """Call a function with its arguments converted to the types of its parameters."""
        arguments = [self.evaluate(argument) for argument in node.args.exprs]
        name = node.name.name
        if name == "__builtin_clz":
            return self._count_leading_zeros(arguments[0])
        parameters = self.program.parameters(name)
        pairs = zip(arguments, parameters, strict=True)
        converted_arguments = [self._convert_argument(argument, parameter) for argument, parameter in pairs]
        return self.call(name, *converted_arguments)

    def _convert_argument(self, argument: Any, parameter: Any) -> Any:
        """Return an argument as the function gets it. An array becomes a pointer to its first element."""
        type_ = self._resolve_type(parameter.type)
        if isinstance(argument, dict) and isinstance(type_, (c_ast.PtrDecl, c_ast.ArrayDecl)):
            return Pointer(argument, 0)
        return self._convert(argument, type_)

    def _count_leading_zeros(self, number: Number) -> Number:
        """Return what __builtin_clz() of gcc and clang does. It is undefined for 0."""
        self.require(number.term != 0, "leading zeros of 0")
        count = z3.BitVecVal(31, self.int_type.bits)
        for bit in range(32):  # from the lowest, so that the highest bit that is set decides
            is_set = z3.Extract(bit, bit, number.term) == 1
            count = z3.If(is_set, z3.BitVecVal(31 - bit, self.int_type.bits), count)
        return Number(count, self.int_type)

    # --- Locations of expressions ---

    def _locate(self, node: Any) -> Pointer:
        """Return a pointer to what an expression names; one that names nothing is an error."""
        if isinstance(node, c_ast.ID):
            return Pointer(self.variables, node.name)
        if isinstance(node, c_ast.StructRef):
            structure = self.evaluate(node.name)
            if node.type == "->":
                structure = self.load(structure)
            return self._locate_member(structure, node.field.name)
        if isinstance(node, c_ast.ArrayRef):
            return self._locate_element(node)
        if isinstance(node, c_ast.UnaryOp) and node.op == "*":
            pointer = self.evaluate(node.expr)
            assert isinstance(pointer, Pointer)
            return pointer
        raise NotImplementedError(f"the machine has no pointer to {type(node).__name__}")

    def _locate_member(self, structure: Any, name: str) -> Pointer:
        """Return a pointer to a member. A union then has this one, made of the bits of the one it had."""
        if isinstance(structure, Union) and name not in structure:
            bits, lowest_bit = structure.bits(), 0

            def take_number(_name: str, type_: IntegerType) -> Number:
                nonlocal lowest_bit
                lowest_bit += type_.bits
                return Number(z3.Extract(lowest_bit - 1, lowest_bit - type_.bits, bits), type_)

            structure.clear()
            structure[name] = self._build_value(structure.declarations[name], name, take_number)
        return Pointer(structure, name)

    def _locate_element(self, node: Any) -> Pointer:
        """Return a pointer to an element of an array, which a pointer to its first element may stand for."""
        index = self.evaluate(node.subscript)
        array = self.evaluate(node.name)
        if isinstance(array, Pointer):
            assert array.key == 0, "a pointer into an array"
            array = array.container
        constant_index = constant_value(index.term)
        if constant_index is not None:
            return Pointer(array, constant_index)
        if isinstance(array, dict):
            type_ = IntegerType(index.type.bits)
            self.require(compare("<", Number(index.term, type_), constant(len(array), type_)), "an element")
        return Pointer(array, index)

    # --- Operators and types ---

    def _update(self, target: Any, symbol: str, right_operand: Number) -> Any:
        """Execute ``target symbol= right``, and return the new value."""
        pointer = self._locate(target)
        return self.store(pointer, self._apply_operator(symbol, self.load(pointer), right_operand))

    def _apply_operator(self, symbol: str, left_operand: Number, right_operand: Number) -> Number:
        """Return the result of an arithmetic operator, after C's usual conversions."""
        if symbol in ("<<", ">>"):  # the count does not change the type of the result
            operands = self._promote(left_operand), self._promote(right_operand)
        else:
            operands = self._to_common_type(left_operand, right_operand)
        return apply_operator(symbol, *operands, self.require)

    def _require_documented_shift(self, node: Any, symbol: str, count: Number) -> None:
        """Require that a shift's count is at most the bound in the comment beside it."""
        max_shift = documented_max_shift(node) if symbol in ("<<", ">>") else None
        if max_shift is not None:
            limit = constant(max_shift, count.type)
            self.require(compare("<=", count, limit), f"a shift by at most {max_shift}")

    def _promote(self, number: Number) -> Number:
        """Return a number as an int, if its type is shorter."""
        return number if number.type.bits >= self.int_type.bits else convert(number, self.int_type)

    def _to_common_type(self, left_operand: Number, right_operand: Number) -> tuple[Number, Number]:
        """Return two numbers as ones of the type in which C computes: the longer one, or the unsigned one."""
        left_operand, right_operand = self._promote(left_operand), self._promote(right_operand)
        bits = max(left_operand.type.bits, right_operand.type.bits)
        # A longer signed type can hold all values of a shorter unsigned one.
        longest_types = [number.type for number in (left_operand, right_operand) if number.type.bits == bits]
        common_type = IntegerType(bits, signed=all(type_.signed for type_ in longest_types))
        return convert(left_operand, common_type), convert(right_operand, common_type)

    def _convert(self, value: Any, type_: Any) -> Any:
        """Return a number as one of an integer type, and anything else unchanged."""
        is_conversion = isinstance(type_, IntegerType) and isinstance(value, Number) and value.type != type_
        return convert(value, type_) if is_conversion else value

    def _to_int(self, condition: Any) -> Number:
        """Return 1 where a condition holds, and 0 elsewhere."""
        bits = self.int_type.bits
        return Number(z3.If(condition, z3.BitVecVal(1, bits), z3.BitVecVal(0, bits)), self.int_type)

    def _evaluate_initializer(self, declaration: Any, node: Any) -> Any:
        """Return the initial value of a variable, of which the node is an expression or a list in braces."""
        type_ = self._resolve_type(declaration)
        if not isinstance(node, c_ast.InitList):
            return self._convert(self.evaluate(node), type_)
        if isinstance(type_, c_ast.ArrayDecl):
            return dict(enumerate(self._evaluate_initializer(type_.type, element) for element in node.exprs))
        declarations = {member.name: member.type for member in type_.decls}
        if isinstance(type_, c_ast.Union):
            # One member has a value: the one that is named, or the first one.
            (expression,) = node.exprs
            name = next(iter(declarations))
            if isinstance(expression, c_ast.NamedInitializer):
                name, expression = expression.name[0].name, expression.expr
            return Union(declarations, name, self._evaluate_initializer(declarations[name], expression))
        # Members that the list leaves out are 0.
        members = self._build_value(type_, "", lambda _, number_type: constant(0, number_type))
        for name, expression in zip(declarations, node.exprs, strict=False):
            members[name] = self._evaluate_initializer(declarations[name], expression)
        return members

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


def all_paths(program: Program, summaries: Mapping[str, Summary] | None = None) -> Iterator[Machine]:
    """Yield new machines, one for each path. The caller has to execute the same code on each of them."""
    waiting_paths: list[tuple[bool, ...]] = [()]
    while waiting_paths:
        machine = Machine(program, summaries, waiting_paths.pop())
        yield machine
        # While the caller executed the code, the machine has found these other paths.
        waiting_paths += machine.other_paths


def terms_of(value: Any) -> Any:
    """Return the solver's terms in a value and in what its pointers point to, by name."""
    if isinstance(value, Pointer):
        # A pointer to the first element stands for the array.
        return terms_of(value.container if value.key == 0 else value.container[value.key])
    if isinstance(value, dict):
        return {name: terms_of(member) for name, member in value.items()}
    return value.term if isinstance(value, Number) else value


def copy_value(value: Any) -> Any:
    """Return a copy of a value. Pointers in it point to the same place as those in the value."""
    if isinstance(value, Union):
        ((name, member),) = value.items()
        return Union(value.declarations, name, copy_value(member))
    if isinstance(value, dict):
        return {name: copy_value(member) for name, member in value.items()}
    return value


def _leaves_of(value: Any) -> Iterator[Any]:
    """Yield the values of all members and elements, in their order in memory."""
    if not isinstance(value, dict):
        yield value
        return
    for member in value.values():
        yield from _leaves_of(member)


def _bits_of(value: Any) -> Any:
    """Return the bits of a number or of a float, as memory has them."""
    return value.term if isinstance(value, Number) else z3.fpToIEEEBV(value)


def _has_effects(node: Any) -> bool:
    """Return whether an expression may change memory or call a function."""
    changes = any(unary.op in ("++", "--", "p++", "p--") for unary in nodes(node, c_ast.UnaryOp))
    return changes or any(nodes(node, c_ast.FuncCall)) or any(nodes(node, c_ast.Assignment))
