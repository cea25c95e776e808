"""The paper's study, with a verdict on each of its claims, and this project's own studies."""
