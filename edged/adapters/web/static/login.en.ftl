# Texts of the forms that come before anything else. The cell writes these pages: each text on one line.

## Log in
login-title = { $cell }: log in
login-name = Name
login-name-or-page = Name (left empty: with the password of the status page)
login-password = Password
login-password-of-page = Password of the status page of { $cell }
login-button = Log in
login-code = I have a code
login-wrong = This name or password is not right.
login-wrong-password = This password is not right.
login-wait = No password is taken for { $wait_s } s: too many were wrong, or another one is being checked. Try again then.

## Come in by a code
invite-title = { $cell }: code
invite-what = The code is in the cell's journal, or comes from { $command }. It makes you an engineer, once.
invite-code = Code
invite-name = Your name
invite-password = A password of { $least } characters at least
invite-again = The same again
invite-wrong = This code is not right, or used up, or older than a day. { $command } makes a new one.
invite-differ = The two passwords differ.
invite-short = A name, please, and a password of { $least } characters at least.
invite-storage = You cannot be made an engineer: { $detail }
