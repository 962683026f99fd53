"""Random scripts for visitors of the mall, and who judges what came of them."""
