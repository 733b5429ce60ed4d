# Texte der Formulare, die vor allem anderen kommen. Die Zelle schreibt diese Seiten: jeder Text auf einer Zeile.

## Anmelden
login-title = { $cell }: Anmelden
login-name = Name
login-name-or-page = Name (leer: mit dem Passwort der Statusseite)
login-password = Passwort
login-password-of-page = Passwort der Statusseite von { $cell }
login-button = Anmelden
login-code = Ich habe einen Code
login-wrong = Name oder Passwort stimmt nicht.
login-wrong-password = Das Passwort stimmt nicht.
login-wait = { $wait_s } s lang wird kein Passwort angenommen: zu viele waren falsch, oder ein anderes wird gerade geprüft. Versuchen Sie es danach noch einmal.

## Mit einem Code hereinkommen
invite-title = { $cell }: Code
invite-what = Der Code steht im Protokoll der Zelle oder kommt von { $command }. Er gibt Ihnen die Rolle „engineer“, einmal.
invite-code = Code
invite-name = Ihr Name
invite-password = Ein Passwort, mindestens { $least } Zeichen
invite-again = Noch einmal dasselbe
invite-wrong = Dieser Code stimmt nicht, ist für einen anderen Namen, wurde schon benutzt oder ist älter als ein Tag. { $command } macht einen neuen.
invite-differ = Die beiden Passwörter sind verschieden.
invite-short = Bitte einen Namen und ein Passwort, mindestens { $least } Zeichen.
invite-common = Dieses Passwort ist zu leicht zu erraten. Nehmen Sie eines aus mehreren Wörtern, ohne Ihren Namen.
invite-storage = Sie können die Rolle „engineer“ nicht bekommen: { $detail }
