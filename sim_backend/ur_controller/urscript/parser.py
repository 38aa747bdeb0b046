"""Parser of URScript. Line ends and indentation have no meaning: a block ends with `end`."""

from __future__ import annotations

from toolee_robot.sim_backend.ur_controller.urscript import syntax
from toolee_robot.sim_backend.ur_controller.urscript.tokens import (
    Kind,
    ScriptError,
    Token,
    TokenReader,
    number,
    tokenise,
)

BINARY = (("or",), ("xor",), ("and",), ("==", "!=", "<", "<=", ">", ">="), ("+", "-"), ("*", "/", "%"))
"""Binary operators, in the order of increasing precedence."""


def parse(source: str) -> syntax.Program:
    """Parse a program: one `def` or `sec`, or bare statements.

    Args:
        source: Text of the program.

    Returns:
        The syntax tree.

    Raises:
        ScriptError: It does not parse.
    """
    return _Parser(tokenise(source)).program()


class _Parser(TokenReader):
    def __init__(self, tokens: list[Token]) -> None:
        super().__init__(tokens)
        self._functions: dict[str, syntax.Function] = {}

    def program(self) -> syntax.Program:
        first = self._peek()
        if first.text in ("def", "sec") and first.kind is Kind.WORD:
            main = self._function()
            if self._peek().kind is not Kind.END:
                raise self._unexpected("nothing after the program's end")
            return syntax.Program(main, self._functions)
        body = self._block()
        if self._peek().kind is not Kind.END:
            raise self._unexpected("a statement")
        if not body:
            raise ScriptError("the script does nothing")
        return syntax.Program(syntax.Function("def", "unnamed", (), (), body, first.line), self._functions)

    # -- statements

    def _function(self) -> syntax.Function:
        """Parse `def | sec | thread name(a, b=1): ... end`."""
        word = self._next()
        name = self._name()
        parameters: list[str] = []
        defaults: list[syntax.Expression] = []
        self._expect("(")
        while not self._accept(")"):
            parameters.append(self._name())
            if self._accept("="):
                defaults.append(self._expression())
            elif defaults:
                raise self._unexpected("a default")
            if not self._is(")"):
                self._expect(",")
        self._expect(":")
        if len(set(parameters)) < len(parameters):
            raise ScriptError(f"{name}() has two parameters of the same name", word.line)
        body = self._block()
        self._expect("end")
        return syntax.Function(word.text, name, tuple(parameters), tuple(defaults), body, word.line)

    def _block(self) -> syntax.Block:
        self._deeper()
        body: list[syntax.Statement] = []
        while self._peek().kind is not Kind.END and not self._is("end", "elif", "else"):
            if self._is("def", "thread"):
                function = self._function()
                if function.name in self._functions:
                    raise ScriptError(f"{function.name}() is defined twice", function.line)
                self._functions[function.name] = function
            elif self._accept("$"):  # the pendant's label of the next line: $ 3 "MoveJ"
                if self._peek().kind is not Kind.NUMBER or self._peek(1).kind is not Kind.STRING:
                    raise self._unexpected("a number and a text")
                self._at += 2
            else:
                body.append(self._statement())
        self._depth -= 1
        return tuple(body)

    def _statement(self) -> syntax.Statement:
        token = self._peek()
        line = token.line
        if token.kind is Kind.NAME:
            return self._assignment_or_call()
        if token.kind is not Kind.WORD:
            raise self._unexpected("a statement")
        match token.text:
            case "global" | "local":
                self._next()
                name = self._name()
                self._expect("=")
                return syntax.Assign(name, token.text, self._expression(), line)
            case "if":
                return self._if()
            case "while":
                self._next()
                condition = self._expression()
                self._expect(":")
                body = self._block()
                self._expect("end")
                return syntax.While(condition, body, line)
            case "return":
                self._next()
                return syntax.Return(None if self._ends(line) else self._expression(), line)
            case "break" | "continue" | "halt" | "enter_critical" | "exit_critical":
                self._next()
                if self._peek().line == line and self._accept("("):
                    self._expect(")")
                return syntax.Keyword(token.text, line)
            case "kill" | "join":
                self._next()
                return syntax.Thread(token.text, self._expression(), line)
            case "run":
                return syntax.Evaluate(self._run(), line)
        raise self._unexpected("a statement")

    def _ends(self, line: int) -> bool:
        """Whether no expression follows on this line."""
        return self._peek().line != line or self._peek().kind is Kind.END or self._is("end", "elif", "else")

    def _if(self) -> syntax.If:
        line = self._next().line
        branches: list[tuple[syntax.Expression, syntax.Block]] = []
        while True:
            condition = self._expression()
            self._expect(":")
            branches.append((condition, self._block()))
            if not self._accept("elif"):
                break
        otherwise: syntax.Block = ()
        if self._accept("else"):
            self._expect(":")
            otherwise = self._block()
        self._expect("end")
        return syntax.If(tuple(branches), otherwise, line)

    def _assignment_or_call(self) -> syntax.Statement:
        line = self._peek().line
        target = self._expression()
        if self._accept("="):
            value = self._expression()
            if isinstance(target, syntax.Name):
                return syntax.Assign(target.name, "", value, line)
            indices: list[syntax.Expression] = []
            while isinstance(target, syntax.Index):
                indices.insert(0, target.index)
                target = target.base
            if indices and isinstance(target, syntax.Name):
                return syntax.AssignItem(target.name, tuple(indices), value, line)
            raise ScriptError("only a variable or an item of one can be assigned to", line)
        if isinstance(target, syntax.Call):
            return syntax.Evaluate(target, line)
        raise self._unexpected("'=' or a call")

    # -- expressions

    def _expression(self, level: int = 0) -> syntax.Expression:
        if level == len(BINARY):
            return self._unary()
        if level == 0:
            self._deeper()
        if BINARY[level][0] == "==" and self._is("not"):
            left: syntax.Expression = syntax.Unary("not", self._negated(level), self._peek().line)
        else:
            left = self._expression(level + 1)
        while self._is(*BINARY[level]) and self._continues():
            operator = self._next()
            left = syntax.Binary(operator.text, left, self._expression(level + 1), operator.line)
        if level == 0:
            self._depth -= 1
        return left

    def _negated(self, level: int) -> syntax.Expression:
        self._expect("not")
        self._deeper()
        operand = (
            syntax.Unary("not", self._negated(level), self._peek().line) if self._is("not") else self._expression(level)
        )
        self._depth -= 1
        return operand

    def _continues(self) -> bool:
        """Whether an operator continues the expression; a `-` at the start of a line does not."""
        return not self._is("-") or self._peek().line == self._tokens[self._at - 1].line

    def _unary(self) -> syntax.Expression:
        if self._is("-", "+"):
            sign = self._next()
            self._deeper()
            operand = self._unary()
            self._depth -= 1
            return syntax.Unary("-", operand, sign.line) if sign.text == "-" else operand
        return self._postfix(self._atom())

    def _postfix(self, expression: syntax.Expression) -> syntax.Expression:
        while self._is("[") and self._peek().line == self._tokens[self._at - 1].line:
            line = self._next().line
            index = self._expression()
            self._expect("]")
            expression = syntax.Index(expression, index, line)
        return expression

    def _atom(self) -> syntax.Expression:
        token = self._peek()
        if token.kind is Kind.NUMBER:
            return syntax.Literal(number(self._next()), token.line)
        if token.kind is Kind.STRING:
            return syntax.Literal(self._next().text, token.line)
        if token.kind is Kind.NAME:
            return self._named()
        if self._is("True", "False"):
            return syntax.Literal(self._next().text == "True", token.line)
        if self._is("run"):
            return self._run()
        if self._accept("("):
            inner = self._expression()
            self._expect(")")
            return inner
        if self._is("["):
            return syntax.ListOf(self._items(), False, token.line)
        raise self._unexpected("a value")

    def _named(self) -> syntax.Expression:
        token = self._next()
        if self._peek().line == token.line and self._is("("):
            return self._call(token, thread=False)
        if token.text == "p" and self._is("[") and self._peek().line == token.line:
            # Six numbers are a pose; a single one is an index into a variable that happens to be called p.
            items = self._items()
            if len(items) == 1:
                return syntax.Index(syntax.Name("p", token.line), items[0], token.line)
            if len(items) != 6:
                raise ScriptError(f"a pose has 6 numbers, not {len(items)}", token.line)
            return syntax.ListOf(items, True, token.line)
        return syntax.Name(token.text, token.line)

    def _items(self) -> tuple[syntax.Expression, ...]:
        self._expect("[")
        items: list[syntax.Expression] = []
        while not self._accept("]"):
            items.append(self._expression())
            if not self._is("]"):
                self._expect(",")
        return tuple(items)

    def _run(self) -> syntax.Call:
        self._expect("run")
        token = self._peek()
        self._name()
        return self._call(token, thread=True)

    def _call(self, token: Token, thread: bool) -> syntax.Call:
        self._expect("(")
        arguments: list[syntax.Expression] = []
        named: list[tuple[str, syntax.Expression]] = []
        while not self._accept(")"):
            if self._peek().kind is Kind.NAME and self._peek(1).text == "=" and self._peek(1).kind is Kind.WORD:
                name = self._name()
                self._expect("=")
                named.append((name, self._expression()))
            elif named:
                raise self._unexpected("a named argument")
            else:
                arguments.append(self._expression())
            if not self._is(")"):
                self._expect(",")
        return syntax.Call(token.text, tuple(arguments), tuple(named), thread, token.line)
