"""Hard cases for both solvers: what is run, what must hold and why; the study and the tests share them."""
