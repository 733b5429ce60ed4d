# Texts of the forms that come before anything else. The cell writes these pages: each text on one line.

## Log in
login-title = { $cell }: log in
login-name = Name
login-name-or-page = Name (leave empty to use the password of the status page)
login-password = Password
login-password-of-page = Password of the status page of { $cell }
login-button = Log in
login-code = I have a code
login-wrong = Wrong name or password.
login-wrong-password = Wrong password.
login-wait = No password is accepted for { $wait_s } s: there were too many wrong ones, or another one is being checked. Try again then.

## Come in by a code
invite-title = { $cell }: code
invite-what = The code is in the cell's journal, or comes from { $command }. It works once, and makes you an engineer.
invite-code = Code
invite-name = Your name
invite-password = Password, { $least } characters or more
invite-again = Repeat the password
invite-wrong = This code is wrong, already used, for another name, or more than a day old. { $command } makes a new one.
invite-differ = The two passwords differ.
invite-short = Enter a name, and a password of at least { $least } characters.
invite-common = This password is guessed too easily. Choose one of several words, without your name.
invite-storage = You cannot be made an engineer: { $detail }
