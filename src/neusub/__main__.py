"""python -m neusub"""

from neusub.cli import main

main()
