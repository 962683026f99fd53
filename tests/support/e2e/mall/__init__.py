"""Random scripts for visitors of the mall, and the verdict on what came of them."""
