"""The paper remade: its figures from closed forms and from ensembles of runs, each beside what the paper says of it."""
