"""`torchid log`: what a log is, before anything is made of it."""

import typer

from torchid.app.log_doctor import doctor_command

log_app = typer.Typer(help="Look at a log before anything is made of it.", no_args_is_help=True)
log_app.command("doctor")(doctor_command)
