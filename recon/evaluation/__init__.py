"""How good is it: comparison with truth, fitted primitives, and the published figures beside ours."""
