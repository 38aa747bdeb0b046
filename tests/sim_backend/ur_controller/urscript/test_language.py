"""The language by itself: expressions against Python, round trips, and nonsense that must end in a typed error."""

from __future__ import annotations

import ast
import math
import re
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.examples import examples
from tests.sim_backend.ur_controller.urscript.script_robot import ScriptRobot
from toolee_robot.sim_backend.ur_controller.urscript import syntax as s
from toolee_robot.sim_backend.ur_controller.urscript.tokens import INT_MAX, KEYWORDS, ScriptError

# -- expressions mean what they mean in Python, except that integers have 32 bits and booleans are no numbers

numerals = st.one_of(
    st.integers(0, INT_MAX).map(str), st.integers(0, 9).map(str), st.floats(1e-3, 1e3).map(lambda f: f"{f:.6f}")
)
arithmetic = st.recursive(
    numerals,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from([" + ", "-", "*", " / ", "%"]), inner).map(lambda t: f"({''.join(t)})"),
        st.tuples(inner, st.sampled_from(["+", " - ", " * "]), inner).map("".join),
        inner.map(lambda text: f"-({text})"),
    ),
    max_leaves=8,
)


def python_value(node: ast.expr) -> float:
    """With 32-bit integers. Raises ArithmeticError."""
    match node:
        case ast.Constant(value=value):
            return value  # type: ignore[return-value]
        case ast.UnaryOp(operand=operand):
            value = -python_value(operand)
        case ast.BinOp(left=left, op=operator, right=right):
            a, b = python_value(left), python_value(right)
            match operator:
                case ast.Add():
                    value = a + b
                case ast.Sub():
                    value = a - b
                case ast.Mult():
                    value = a * b
                case ast.Div():
                    value = a / b
                case _:
                    value = a % b
        case _:
            raise AssertionError(node)
    if isinstance(value, int) and not -INT_MAX - 1 <= value <= INT_MAX:
        raise OverflowError
    return value


@given(arithmetic)
@examples(150)
@example("2 + 3 * 4 - 10 / 4")
@example("7 % 3 * 2")
def test_arithmetic_is_pythons(text: str) -> None:
    try:
        expected = python_value(ast.parse(text, mode="eval").body)
    except ArithmeticError:
        with pytest.raises(ScriptError):
            ScriptRobot().value(text)
        return
    found = ScriptRobot().value(text)
    assert found == expected or math.isclose(found, expected, rel_tol=1e-12)


logic = st.recursive(
    st.one_of(
        st.sampled_from(["True", "False"]),
        st.tuples(
            st.integers(0, 3).map(str), st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), st.integers(0, 3).map(str)
        ).map(" ".join),
    ),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from([" and ", " or "]), inner).map("".join),
        st.tuples(inner, inner).map(lambda t: f"(({t[0]}) xor ({t[1]}))"),
        inner.map(lambda text: f"not ({text})"),
    ),
    max_leaves=8,
)


@given(logic)
@examples(100)
def test_logic_is_pythons(text: str) -> None:
    robot = ScriptRobot()
    robot.run(f"write_output_boolean_register(0, {text})")
    assert robot.registers.bool_out[0] is eval(text.replace("xor", "!="))


# -- what is printed parses to the same tree

names = st.sampled_from(["a", "async", "p", "Tool_1", "speed", "q2"])
expressions: st.SearchStrategy[Any] = st.recursive(
    st.one_of(
        st.integers(0, INT_MAX).map(lambda v: s.Literal(v, 0)),
        st.floats(0, 1e6).map(lambda v: s.Literal(v, 0)),
        st.booleans().map(lambda v: s.Literal(v, 0)),
        st.text("abc #:'[]", max_size=6).map(lambda v: s.Literal(v, 0)),
        names.map(lambda v: s.Name(v, 0)),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4).map(lambda v: s.ListOf(tuple(v), False, 0)),
        st.lists(inner, min_size=6, max_size=6).map(lambda v: s.ListOf(tuple(v), True, 0)),
        st.tuples(names.map(lambda v: s.Name(v, 0)), inner).map(lambda t: s.Index(*t, 0)),
        st.tuples(st.sampled_from(["-", "not"]), inner).map(lambda t: s.Unary(*t, 0)),
        st.tuples(st.sampled_from(["+", "-", "*", "/", "%", "==", "<", "and", "or", "xor"]), inner, inner).map(
            lambda t: s.Binary(*t, 0)
        ),
        st.tuples(names, st.lists(inner, max_size=2), st.lists(st.tuples(names, inner), max_size=2)).map(
            lambda t: s.Call(t[0], tuple(t[1]), tuple(t[2]), False, 0)
        ),
    ),
    max_leaves=8,
)


def printed(node: Any) -> str:
    match node:
        case s.Literal(value=str()):
            return f'"{node.value}"'
        case s.Literal():
            return repr(node.value)
        case s.Name():
            return node.name
        case s.ListOf():
            return ("p" if node.pose else "") + f"[{', '.join(map(printed, node.items))}]"
        case s.Index():
            return f"{printed(node.base)}[{printed(node.index)}]"
        case s.Unary():
            return f"({node.operator} {printed(node.operand)})"
        case s.Binary():
            return f"({printed(node.left)} {node.operator} {printed(node.right)})"
        case s.Call():
            arguments = [printed(a) for a in node.arguments] + [f"{n}={printed(e)}" for n, e in node.named]
            return f"{node.name}({', '.join(arguments)})"
        case s.Assign():
            return f"{node.scope} {node.name} = {printed(node.value)} # a comment: end"
        case s.AssignItem():
            return f"{node.name}{''.join(f'[{printed(i)}]' for i in node.indices)} = {printed(node.value)}"
        case s.Evaluate():
            return printed(node.call)
        case s.Return():
            return f"return {'' if node.value is None else printed(node.value)}"
        case s.Keyword():
            return node.word
        case s.Thread():
            return f"{node.word} {printed(node.thread)}"
        case s.If():
            text = " el".join(f"if {printed(test)}:\n {block(body)}\n" for test, body in node.branches)
            return f"{text}else:\n{block(node.otherwise)}\nend" if node.otherwise else f"{text}end"
        case s.While():
            return f"while {printed(node.condition)}:\n{block(node.body)}\n   end"
    raise AssertionError(node)


def block(body: Any) -> str:
    return "\n".join(map(printed, body))


# -- nonsense

words = st.one_of(
    st.sampled_from([*sorted(KEYWORDS), "(", ")", "[", "]", "=", "==", ",", ":", "-", "*", "/", "%", "<", "$", "\n"]),
    st.sampled_from(["a", "p", "f", "f()", "t()", "sync()", "textmsg", "norm", "0", "1.5", '"x"', "p[0,0,0,0,0,0]"]),
    st.sampled_from(["def f():", "thread t():", "while True:", "a =", "global a = 1", "movej([0,0,0,0,0,0])"]),
)


@given(st.one_of(st.lists(words, max_size=40).map(" ".join), st.binary(max_size=60).map(lambda b: b.decode("latin1"))))
@examples(300)
@example("(" * 5000)
@example("a = " + "-" * 5000 + "1")
@example("a = " + "not " * 5000 + "True")
@example("a = 1" + " + 1" * 20_000)
@example("while True:\n" * 30 + "end\n" * 30)
@example("if True:\n" * 200)
@example("a = 9999999999999999999999")
@example("def f():\nf()\nend")
def test_nonsense_ends_in_a_typed_error(text: str) -> None:
    robot = ScriptRobot()
    try:
        runtime = robot.start(text)
    except ScriptError:
        return
    robot.tick(3)
    runtime.stop()
    robot.tick(round(robot.model.rate))  # a second: long enough for every stop
    assert not runtime.running
    assert not robot.machine.moving


@pytest.mark.parametrize(
    ("source", "expected_text", "line"),
    [
        ("def a():\n x = 1 +\nend", "expected a value", 3),
        ("def a():\n if True:\n  sync()\n end\n", "expected 'end'", 5),
        ("def a():\n flyj([0,0,0,0,0,0])\nend", "no function flyj", 2),
        ("def a():\n movej()\nend", "missing a required argument: 'q'", 2),
        ("def a():\n sleep(1, t=2)\nend", "multiple values for argument 't'", 2),
        ("def a():\n textmsg(x)\nend", "x is never set", 2),
        ("def a():\n x = p[1, 2, 3]\nend", "a pose has 6 numbers", 2),
        ("def a():\n break\nend", "outside of a loop", 2),
        ("def a():\n thread t():\n end\n t()\nend", "`run`", 4),
        ("def a():\n def f(x):\n return x\n end\n f()\nend", "missing a required argument", 5),
        ("sec a():\n movej([0, 0, 0, 0, 0, 0])\nend", "takes time", 2),
        ('def a():\n x = "open\nend', "unexpected '\"'", 2),
        ("", "does nothing", 0),
    ],
)
def test_what_does_not_parse_names_the_line(source: str, expected_text: str, line: int) -> None:
    with pytest.raises(ScriptError, match="(?s)" + expected_text.replace("(", r"\(")) as caught:
        ScriptRobot().start(source)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("body", "expected_text"),
    [
        ("x = 1 / 0", "division by zero"),
        ("x = True + 1", "expected two numbers, got a boolean and an integer"),
        ("x = 2147483647 + 1", "32 bits"),
        ("x = [1, 2]\n x[2] = 0", "outside a list of 2"),
        ("x = sqrt(-1)", "domain"),
        ("if 1:\n  sync()\n end", "expected a boolean"),
        ("if False:\n  x = 1\n end\n textmsg(x)", "x has no value yet"),
        ("while True:\n end", "an endless loop"),
        ("def f():\n  return f()\n end\n f()", "loop|recursion"),
        ("x = [1]\n while True:\n  x = [x, x]\n end", "nested twice"),
        ("thread t():\n  run t()\n end\n run t()\n sync()", "threads"),
        ("x = get_inverse_kin(p[9, 9, 9, 0, 0, 0])", "no joints reach"),
        ("movej([0, 0, 0, 0, 0, 9])", "outside their limits"),
        ("servoj([0, 0, 0])", "6 numbers"),
        ('rtde_set_watchdog("input_int_register_0", 10, "panic")', "panic"),
    ],
)
def test_what_fails_ends_the_program_and_says_where(body: str, expected_text: str) -> None:
    robot = ScriptRobot()
    runtime = robot.run(f"def a():\n sync()\n {body}\n textmsg(9)\nend")
    assert runtime.error is not None
    assert runtime.error.line in (3, 4, 5, 6)
    assert re.search(expected_text, str(runtime.error))
    assert "9" not in robot.messages


def test_line_ends_and_indentation_mean_nothing() -> None:
    robot = ScriptRobot()
    robot.run(
        """def a():
# the value stands on the next line, and the next statement behind it
  global offset = # comment
0  global other =
2
      $ 7 "label of the pendant"
 if offset == 0 and
 other == 2: textmsg("both") else: textmsg("no") end
end"""
    )
    assert robot.messages == ["both"]


def test_values_are_copied_and_scopes_are_the_manuals() -> None:
    robot = ScriptRobot()
    runtime = robot.run(
        """def a():
  global g = [1, 2]
  global n = 0
  h = g
  h[0] = 5
  def change(p, k=3):
    p[0] = p[0] * k
    n = n + 1
    local g = 7
    return p
  end
  def keep():
    return g
  end
  textmsg(change(g), g)
  kept = keep()
  kept[1] = 9
  pose = p[0, 0, 0, 0, 0, 1]
  textmsg(change(p=pose, k=2), pose)
  textmsg(g, h)
  textmsg("n=", n)
end"""
    )
    assert runtime.error is None
    assert robot.messages == ["[3, 2][1, 2]", "p[0, 0, 0, 0, 0, 1]p[0, 0, 0, 0, 0, 1]", "[1, 2][5, 2]", "n=2"]


def test_async_is_a_name_and_p_is_both_pose_and_list() -> None:
    robot = ScriptRobot()
    robot.run("def a():\n async = 1\n p = p[4, 0, 0, 0, 0, 0]\n textmsg(p[0] + async)\nend")
    assert robot.messages == ["5"]
